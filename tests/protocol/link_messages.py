#!/usr/bin/env python3
"""An independent implementation of the messages of a `ble` link, written from `PROTOCOL.md`: the advertisement, the
handshake with the answers of a listener, connection intervals, the SDUs of an open link, and the rules by which a pair
of nodes has one link.

usage: link_messages.py [--write]
Compares its results with the test vectors in the folders `vectors` of the links' crates, or writes them.
"""

from __future__ import annotations

import struct
import zlib
from math import gcd
from typing import NamedTuple

from link_keys import SECRET, VERSION, Noise, hello, main, psk_of, public_key
from link_keys import VECTORS as LANES

RADIO = LANES.parent.parent / "zenoh-link-ble-radio" / "vectors"
BLE = LANES.parents[2] / "zenoh-link-ble" / "vectors"
SERVICE_DATA_VERSION = 1
SDU_OVERHEAD = 24
MAX_WINDOW = 16384
LANE_LIMIT = 16384


def crc(data: bytes) -> int:
    return zlib.crc32(data)


def folded(value: int) -> int:
    return (value >> 16) ^ (value & 0xFFFF)


# Section 1.
def advertisement(name: str, fleet: str, psm: int, plain: bool, incarnation: int) -> bytes:
    fleet_hash = max(1, folded(crc(fleet.encode()))) if fleet else 0
    return struct.pack("<BBIHH", SERVICE_DATA_VERSION << 4 | plain, psm, crc(name.encode()), fleet_hash, incarnation)


# Section 3.
def refuse(code: int) -> bytes:
    return b"RECT" + bytes([3, VERSION, code])


def with_tail(message: bytes, size: int) -> bytes:
    return message.ljust(size, b"\x09")


def changed(message: bytes, at: int, value: bytes) -> bytes:
    return message[:at] + value + message[at + len(value) :]


def key(version: int = VERSION, public: bytes | None = None) -> bytes:
    header = b"RECT" + bytes([4, version])
    noise = Noise(header, psk_of(SECRET))
    public = public_key(bytes(range(1, 33))) if public is None else public
    noise.ephemeral(public)
    return header + public + noise.encrypt_nothing()


def intervals(*units: int, count: int | None = None) -> bytes:
    return b"I" + bytes([len(units) if count is None else count]) + b"".join(struct.pack("<H", one) for one in units)


def path(link: int, flags: int) -> bytes:
    return b"P" + bytes([flags]) + struct.pack("<Q", link)


def handshake() -> dict[str, object]:
    good = hello(1, 5, b"wombat-1")
    accept, key_answer = hello(2, 6, b"wombat-2"), b"RECT" + bytes([5, VERSION]) + bytes(48)
    older, small = changed(good, 5, b"\x01"), changed(good, 14, struct.pack("<H", 127))
    wrong_tag = changed(key(), 53, bytes([key()[53] ^ 1]))
    none, secret, version, malformed = "none", refuse(6).hex(), refuse(1).hex(), refuse(7).hex()
    # The first SDU, and the answers of a listener without a secret and of one with a secret.
    first = [
        ("a hello", good, "accept", secret),
        ("a hello of a later version", changed(good, 5, b"\x03"), "accept", secret),
        ("a hello of 128 bytes", with_tail(good, 128), "accept", secret),
        ("a hello of an older version", older, version, version),
        ("an older version takes precedence over a small mtu", changed(older, 14, bytes(2)), version, version),
        ("a hello of 129 bytes", with_tail(good, 129), malformed, malformed),
        ("the length takes precedence over an older version", with_tail(older, 129), malformed, malformed),
        ("a hello that ends within its name", good[:-1], malformed, malformed),
        ("a hello without a name's length", good[:18], malformed, malformed),
        ("an mtu of 127", small, malformed, malformed),
        ("an mtu of 128", changed(good, 14, struct.pack("<H", 128)), "accept", secret),
        ("a window of 511", changed(good, 16, struct.pack("<H", 511)), malformed, malformed),
        ("a window of 512", changed(good, 16, struct.pack("<H", 512)), "accept", secret),
        ("a name of 30 bytes", hello(1, 5, b"x" * 30), malformed, malformed),
        ("a name that is not utf-8", hello(1, 5, b"wombat\xff"), malformed, malformed),
        ("no name", hello(1, 5, b""), "accept", secret),
        ("a key", key(), secret, "key answer"),
        ("a key of a later version", key(3), secret, "key answer"),
        ("a key with further bytes", with_tail(key(), 128), secret, "key answer"),
        ("a key of low order", key(public=bytes(32)), secret, "key answer"),
        ("a key of an older version", key(1), version, version),
        ("a key with a wrong tag", wrong_tag, secret, malformed),
        ("a key that ends within its tag", key()[:-1], malformed, malformed),
        ("a key of 129 bytes", with_tail(key(), 129), malformed, malformed),
        ("an unknown kind", b"RECT\x06\x02 and so on", malformed, malformed),
        ("no kind", b"RECT", malformed, malformed),
        ("an accept", accept, none, none),
        ("half an accept", accept[:20], none, none),
        ("a key answer", key_answer, none, none),
        ("a refusal", refuse(4), none, none),
        ("an init syn of zenoh", bytes.fromhex("01090203"), "plain", none),
        ("an init syn with flags", bytes.fromhex("e1090203"), "plain", none),
        ("the head of an init syn alone", b"\x01", none, none),
        ("another protocol", b"GET / HTTP/1.1", none, none),
    ]
    # The SDU after KEY ANSWER before it is sealed, the answer, and whether that is sealed.
    sealed = [
        ("a hello", b"\xf0" + good, "accept", True),
        ("a hello of a later version", b"\xf0" + changed(good, 5, b"\x03"), "accept", True),
        ("a hello of an older version", b"\xf0" + older, version, True),
        ("an mtu of 127", b"\xf0" + small, malformed, True),
        ("a window of 511", b"\xf0" + changed(good, 16, struct.pack("<H", 511)), malformed, True),
        ("a hello of 129 bytes", b"\xf0" + with_tail(good, 129), malformed, True),
        ("an accept", b"\xf0" + accept, malformed, True),
        ("a key", b"\xf0" + key(), malformed, True),
        ("a refusal", b"\xf0" + refuse(6), malformed, True),
        ("an unknown kind", b"\xf0RECT\x06\x02", malformed, True),
        ("no message", b"\xf0", malformed, True),
        ("a batch", b"\x00a batch", malformed, True),
    ]
    hellos = [
        (good, None, None, False),
        (accept, None, None, False),
        (good + intervals(24, 25, 3200), [24, 25, 3200], None, False),
        (good + intervals(0, 25), [0, 25], None, False),
        (good + intervals(24) + path(7, 1), [24], 7, True),
        (good + path(1 << 63, 0), None, 1 << 63, False),
        (good + path(7, 0xFE), None, 7, False),
        (good + path(7, 0xFF), None, 7, True),
        # Intervals that are not valid are none. The fields after them count.
        (good + intervals(5) + path(7, 0), None, 7, False),
        (good + intervals(24, 3201) + path(7, 0), None, 7, False),
        (good + intervals(24, 0) + path(7, 0), None, 7, False),
        (good + intervals() + path(7, 0), None, 7, False),
        (good + intervals(*range(6, 31)) + path(7, 0), None, 7, False),
        (good + intervals(*range(6, 30)) + path(7, 0), list(range(6, 30)), 7, False),
        # Fields that are cut off, in another order, or after unknown ones are none.
        (good + intervals(24, count=3), None, None, False),
        (good + path(7, 0)[:-1], None, None, False),
        (good + path(7, 0) + intervals(24), None, 7, False),
        (good + b"X" + intervals(24), None, None, False),
    ]
    compressed = [
        (good, False),
        (good + b"C", True),
        (accept + b"C and further bytes", True),
        (good + intervals(24) + path(7, 1) + b"C", True),
        (good + intervals(24) + b"C", True),
        (good + path(7, 1) + b"C", True),
        (good + intervals(5) + path(7, 1) + b"C", True),
        (good + b"XC", False),
        (good + b"C" + path(7, 1), True),
        (good + path(7, 1)[:-1], False),
    ]
    return {
        "secret": SECRET,
        "first": [
            {"case": case, "sdu": sdu.hex(), "without_secret": without, "with_secret": with_secret}
            for case, sdu, without, with_secret in first
        ],
        "sealed": [
            {"case": case, "content": content.hex(), "answer": answer, "answer_is_sealed": is_sealed}
            for case, content, answer, is_sealed in sealed
        ],
        "hellos": [
            {
                "sdu": sdu.hex(),
                "node": int.from_bytes(sdu[6:14], "little"),
                "mtu": 1000,
                "window": 12000,
                "name": sdu[19 : 19 + sdu[18]].decode(),
                "intervals": units,
                "link": link,
                "joins": joins,
            }
            for sdu, units, link, joins in hellos
        ],
        # Hellos, and whether their senders accept compressed batches.
        "compressed": [[sdu.hex(), accepts] for sdu, accepts in compressed],
        # Pairs of hellos, that of the lower node id first.
        "order": [[hello(1, node, b"").hex() for node in pair] for pair in [(1, 1 << 56), (255, 256), (0, 1 << 63)]],
    }


# Section 3, "Connection intervals".
def conflict(one: int, other: int) -> bool:
    return min(one, other) // gcd(one, other) < 3


def agreed(requested: int, central: list[int], peripheral: list[int]) -> int:
    if not any(conflict(requested, other) for other in peripheral):
        return requested
    around = [requested, *(requested + sign * step for step in range(1, 9) for sign in (1, -1))]
    # Of several with the fewest conflicts, `min` returns the first.
    return min(
        (one for one in around if 6 <= one <= 3200),
        key=lambda one: sum(conflict(one, other) for other in central + peripheral),
    )


def radio() -> dict[str, object]:
    pairs = [(24, 24), (24, 25), (12, 24), (16, 24), (12, 9), (6, 7), (6, 9), (18, 24), (3200, 6), (3199, 6)]
    links = [
        (24, [], []),
        (24, [24], []),
        (24, [], [24]),
        (24, [25], [24]),
        (24, [], [24, 25, 23]),
        (6, [], [6]),
        (3200, [], [3200]),
        (12, [9, 9, 10], [12, 11, 13]),
        (12, list(range(6, 18)), list(range(6, 18))),
    ]
    advertised = [("wombat-2", "", 0x95, False, 7), ("wombat-2", "lions", 0x80, True, 0xFFFF), ("", "", 0xFF, False, 0)]
    return {
        "conflicts": [[one, other, conflict(one, other)] for one, other in pairs],
        "agreed": [
            {
                "requested": one,
                "central": central,
                "peripheral": peripheral,
                "interval": agreed(one, central, peripheral),
            }
            for one, central, peripheral in links
        ],
        "advertisements": [
            {"name": name, "fleet": fleet, "psm": psm, "plain": plain, "incarnation": incarnation, "data": data.hex()}
            for name, fleet, psm, plain, incarnation in advertised
            for data in [advertisement(name, fleet, psm, plain, incarnation)]
        ],
    }


# Section 6.
class Node(NamedTuple):
    """A peer, or a link with it. Only the last byte of its address is stated."""

    node: int
    name: str
    address: int
    is_dialled: bool = False
    age_ms: int = 0


class Dial(NamedTuple):
    name: str
    is_hello_sent: bool


class Decision(NamedTuple):
    answer: int | None
    ended: list[int]
    cancelled: list[int]


def decide(own: Node, max_links: int, links: list[Node], dials: list[Dial], peer: Node) -> Decision:
    """The code of the refusal, if there is one, and otherwise the links and the dials that end."""

    def refused(code: int) -> Decision:
        return Decision(code, [], [])

    same_name = [link for link in links if link.name == peer.name]
    if peer.name and (
        peer.name == own.name or any(one.node != peer.node and one.address != peer.address for one in same_name)
    ):
        return refused(5)
    if own.node < peer.node and any(dial.is_hello_sent and dial.name == peer.name for dial in dials):
        return refused(3)
    if any(link.node == peer.node and link.is_dialled and link.age_ms < 5000 for link in links):
        return refused(2)
    if sum(not link.is_dialled and link.node != peer.node for link in links) >= max_links:
        return refused(4)

    def is_ended(link: Node) -> bool:
        is_restarted = peer.name != "" and (link.name, link.address) == (peer.name, peer.address)
        return link.node == peer.node or is_restarted

    ended = [n for n, link in enumerate(links) if is_ended(link)]
    return Decision(None, ended, [n for n, dial in enumerate(dials) if peer.name and dial.name == peer.name])


def pair() -> list[object]:
    own = Node(10, "own", 1)
    higher, lower = Node(11, "peer", 2), Node(9, "peer", 2)
    other = Node(20, "other", 3)
    cases: list[tuple[str, int, list[Node], list[Dial], Node]] = [
        ("a new peer", 7, [other], [], higher),
        ("crossing hellos, and this node's id is lower", 7, [], [Dial("peer", True)], higher),
        ("crossing hellos, and this node's id is higher", 7, [], [Dial("peer", True)], lower),
        ("node ids differ in the highest byte", 7, [], [Dial("peer", True)], Node(1 << 56, "peer", 2)),
        ("a dial that has not sent its hello", 7, [], [Dial("peer", False)], higher),
        ("a dial to another peer", 7, [], [Dial("third", True)], higher),
        ("a link that this node has just dialled", 7, [Node(11, "peer", 2, True, 4999)], [], higher),
        ("a link that this node has dialled before", 7, [Node(11, "peer", 2, True, 5000)], [], higher),
        ("a link that the peer has just dialled", 7, [Node(11, "peer", 2)], [], higher),
        ("a restarted peer", 7, [Node(12, "peer", 2)], [], higher),
        ("a restarted peer that this node has just dialled", 7, [Node(12, "peer", 2, True)], [], higher),
        ("a peer with another address", 7, [Node(11, "peer", 4)], [], higher),
        ("a peer with another name and address", 7, [Node(11, "before", 4)], [], higher),
        ("another device with the name", 7, [Node(12, "peer", 4)], [], higher),
        ("another node with the address", 7, [Node(12, "third", 2)], [], higher),
        ("this node's own name", 7, [], [], Node(11, "own", 2)),
        ("no name", 7, [Node(12, "", 4)], [], Node(11, "", 2)),
        ("too many links", 1, [other], [], higher),
        ("links that this node has dialled do not count", 1, [Node(20, "other", 3, True)], [], higher),
        ("a replaced link does not count", 1, [Node(11, "peer", 2)], [], higher),
        ("a crossing dial takes precedence over too many links", 1, [other], [Dial("peer", True)], higher),
    ]
    return [
        {
            "case": case,
            "own": own._asdict(),
            "max_links": max_links,
            "links": [link._asdict() for link in links],
            "dials": [dial._asdict() for dial in dials],
            "peer": peer._asdict(),
            **decide(own, max_links, links, dials, peer)._asdict(),
        }
        for case, max_links, links, dials, peer in cases
    ]


# Section 4.
def checked(number: int, content: bytes) -> bytes:
    return content + struct.pack("<H", folded(crc(struct.pack("<I", number) + content)))


class Checked:
    """Appends the checks of one direction."""

    def __init__(self) -> None:
        self.number = 0

    def __call__(self, content: bytes) -> bytes:
        self.number += 1
        return checked(self.number - 1, content)


def sdus(*contents: bytes) -> list[bytes]:
    check = Checked()
    return [check(content) for content in contents]


def batch(size: int, lane: int = 0) -> bytes:
    return bytes([lane]) + b"\x07" * size


def answers(window: int, batches: list[int]) -> list[list[bytes]]:
    """The SDUs that a receiver sends after each batch of a lane of which it takes none."""
    check, received, acknowledged, is_stopped = Checked(), 0, 0, False
    sent: list[list[bytes]] = []
    for size in batches:
        received += size + SDU_OVERHEAD
        sent.append([])
        if received > LANE_LIMIT and not is_stopped:
            is_stopped = True
            sent[-1].append(check(b"\x25"))
        if received - acknowledged >= min(512, min(window, MAX_WINDOW) // 4):
            acknowledged = received
            sent[-1].append(check(b"\x10" + struct.pack("<H", received % 65536)))
    return sent


def open_link() -> dict[str, object]:
    mtu, window = 128, 1200
    contents = [(0, b"\x00a batch"), (1, b"\x10\x00\x02"), (65536, b"\x25"), (0xFFFFFFFF, b"\x40\x00")]
    one = checked(0, batch(20))
    ack = struct.pack("<H", 1)
    # The SDUs that arrive on a link, and the reason of the goodbye if the last one ends it.
    received: list[tuple[str, list[bytes], int | None]] = [
        ("batches on several lanes", sdus(batch(1), batch(mtu, 7), batch(20, 3)), None),
        ("every other kind", sdus(b"\x10\x00\x00", b"\x25", b"\x35", b"\x50\x18\x00", b"\x40\x00"), None),
        ("stop and go of a lane that is in that state already", sdus(b"\x35", b"\x25", b"\x25"), None),
        ("an interval out of range is ignored", sdus(b"\x50\x05\x00", b"\x50\xff\xff", batch(1)), None),
        ("an unknown reason of a goodbye", sdus(b"\x40\xc8"), None),
        ("an sdu twice", [one, one], 3),
        ("an sdu that follows a lost one", [checked(1, batch(20))], 3),
        ("a changed bit", [changed(one, 5, b"\x06")], 3),
        ("one byte", [b"\x00"], 2),
        ("a check alone", [checked(0, b"")], 2),
        ("a head and a part of its check", [checked(0, b"\x25")[:-1]], 2),
        ("the check takes precedence over the kind", [b"\x60\x01\x00\x00"], 3),
        ("an unknown kind", sdus(b"\x60\x01"), 2),
        ("the head of a sealed message", sdus(b"\xf0RECT"), 2),
        ("a lane above 7", sdus(b"\x08\x01"), 2),
        ("an acknowledgement with a lane", sdus(b"\x13\x01\x00"), 2),
        ("a goodbye with a lane", sdus(b"\x41\x00"), 2),
        ("an interval with a lane", sdus(b"\x51\x18\x00"), 2),
        ("an empty batch", sdus(b"\x00"), 2),
        ("an acknowledgement of one byte", sdus(b"\x10\x01"), 2),
        ("an acknowledgement of three bytes", sdus(b"\x10\x01\x00\x00"), 2),
        ("a stop with a body", sdus(b"\x20\x01"), 2),
        ("a goodbye without a reason", sdus(b"\x40"), 2),
        ("a batch over the mtu", sdus(batch(mtu + 1)), 2),
        ("the size takes precedence over the check", [bytes(mtu + 4)], 2),
        ("more than was sent is acknowledged", sdus(b"\x10" + ack), 2),
    ]
    # The batches of this test are not acknowledged, because no acknowledgement is sent.
    full, rest = divmod(window, mtu + SDU_OVERHEAD)
    exact = [batch(mtu)] * full + [batch(rest - SDU_OVERHEAD)]
    received += [
        ("exactly the window", sdus(*exact), None),
        ("one byte beyond the window", sdus(*exact[:-1], batch(rest - SDU_OVERHEAD + 1)), 2),
    ]
    acknowledged = [(12000, [487, 1, 488, 600]), (1000, [225, 1, 226]), (65535, [1000] * 20)]
    return {
        "checks": [
            {"number": n, "content": content.hex(), "sdu": checked(n, content).hex()} for n, content in contents
        ],
        "mtu": mtu,
        "window": window,
        "received": [
            {"case": case, "sdus": [sdu.hex() for sdu in arrived], "goodbye": goodbye}
            for case, arrived, goodbye in received
        ],
        # Batches on lane 5, which the receiver does not take, and the SDUs that it sends after each.
        "acknowledgements": [
            {
                "window": size,
                "batches": batches,
                "sdus": [[sdu.hex() for sdu in sent] for sent in answers(size, batches)],
            }
            for size, batches in acknowledged
        ],
    }


# Section 4.1.
class Stream:
    """Compresses the batches of one direction."""

    def __init__(self, level: int = 9) -> None:
        self.deflate = zlib.compressobj(level, zlib.DEFLATED, -15)
        self.first = b"\x3f"

    def __call__(self, batch: bytes, flush: int = zlib.Z_SYNC_FLUSH) -> bytes:
        part = self.deflate.compress(batch) + self.deflate.flush(flush)
        first, self.first = self.first, b"\x1f"
        return first + part.removesuffix(b"\x00\x00\xff\xff")


def compression() -> dict[str, object]:
    mtu = 1000
    batches = [b"\x25" + b"".join(b"rect/wombat-%d/arm/%d;" % (one, n) for n in range(20)) for one in range(3, 8)]
    stored, several, second = Stream(0), Stream(), Stream()
    exact, larger, final, empty, damaged = Stream(), Stream(), Stream(), Stream(), Stream()
    continued = [several(batch) for batch in batches]
    plain = b"\x04"
    changed_head = changed(damaged(batches[0]), 1, b"\x07")
    # The bytes that arrive, and their batch; none if they end the link.
    streams: list[tuple[str, list[tuple[bytes, bytes | None]]]] = [
        ("a stream", list(zip(continued, batches, strict=True))),
        ("batches that are not compressed", [(continued[0], batches[0]), (plain, plain), (continued[1], batches[1])]),
        ("a stream without compression", [(stored(batch), batch) for batch in batches]),
        ("a second stream", [(continued[0], batches[0]), (second(batches[1]), batches[1])]),
        ("a batch of the mtu", [(exact(bytes(mtu)), bytes(mtu))]),
        ("a batch over the mtu", [(larger(bytes(mtu + 1)), None)]),
        ("no beginning", [(continued[1], None)]),
        ("a part that is missing", [(continued[0], batches[0]), (b"\x1f\x07", None)]),
        ("the end of a stream", [(final(batches[0], zlib.Z_FINISH), None)]),
        ("an empty batch", [(empty(b""), None)]),
        ("no part", [(b"\x3f", None)]),
        ("another kind of block", [(changed_head, None)]),
    ]
    return {
        "mtu": mtu,
        "streams": [
            {"case": case, "parts": [[part.hex(), None if batch is None else batch.hex()] for part, batch in parts]}
            for case, parts in streams
        ],
    }


if __name__ == "__main__":
    main(
        __doc__,
        {
            LANES / "compression.json": compression,
            LANES / "handshake.json": handshake,
            LANES / "open-link.json": open_link,
            RADIO / "radio.json": radio,
            BLE / "pair.json": pair,
        },
    )
