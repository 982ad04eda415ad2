#!/usr/bin/env python3
"""An independent implementation of an `any` link, written from `PROTOCOL.md` of `zenoh-link-any`: the proof and the
encryption of a TCP connection, frames, positions, batches and offers.

usage: any_link.py [--write]
Compares its result with the test vectors in crates/zenoh-link-any/vectors/version-1.json, or writes them.
"""

from __future__ import annotations

import ipaddress
import struct

from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
from link_keys import VECTORS as LANES
from link_keys import Noise, exchange, main, public_key

VECTORS = LANES.parents[1] / "zenoh-link-any" / "vectors"
NOISE = b"Noise_NNpsk0_25519_ChaChaPoly_SHA256"
SPAN = 1 << 24
MAX_BATCH = 16000
MAX_EARLY = 1 << 20


# Section 4.
class Direction:
    """Encrypts the frames of one direction."""

    def __init__(self, key: bytes) -> None:
        self.key = key
        self.number = 0

    def seal(self, frame: bytes) -> bytes:
        nonce = bytes(4) + struct.pack("<Q", self.number)
        self.number += 1
        # Without associated data.
        sealed = ChaCha20Poly1305(self.key).encrypt(nonce, frame, b"")
        return struct.pack("<H", len(sealed)) + sealed


def connection(dialler: str, link_key: bytes, tag: bytes) -> dict[str, object]:
    private = bytes(range(1, 33)), bytes(range(101, 133))
    noise = Noise(b"RECT any 1 " + dialler.encode(), link_key, NOISE)
    # -> psk, e
    noise.mix_key_and_hash(link_key)
    noise.ephemeral(public_key(private[0]))
    opening = b"RECTA\x01" + tag[:8] + public_key(private[0]) + noise.encrypt_nothing()
    # <- e, ee
    noise.ephemeral(public_key(private[1]))
    noise.mix_key(exchange(private[0], public_key(private[1])))
    answer = public_key(private[1]) + noise.encrypt_nothing()
    one, other = (Direction(key) for key in noise.split())
    return {
        "dialler": dialler,
        "opening": opening.hex(),
        "answer": answer.hex(),
        # The first is the confirmation.
        "dialler_frames": [one.seal(frame).hex() for frame in (b"", b"\x13")],
        "listener_frames": [other.seal(frame).hex() for frame in (b"\x12\x01\x00\x00\x00", b"\x13")],
    }


# Section 3.
def data(lane: int, position: int, content: bytes, lazy: bool = False) -> bytes:
    return bytes([lane << 5 | (0x11 if lazy else 0x10)]) + struct.pack("<I", position % SPAN)[:3] + content


def restored(lower: int, expected: int) -> int | None:
    """The position with these lower bits that is nearest to the next one."""
    candidates = [expected - expected % SPAN + lower + turn * SPAN for turn in (-1, 0, 1)]
    nearest = min(candidates, key=lambda one: abs(one - expected))
    return nearest if nearest >= 0 else None


# Section 2.
def with_length(batch: bytes) -> bytes:
    size = len(batch)
    return (bytes([size]) if size < 128 else bytes([0x80 | size >> 8, size & 0xFF])) + batch


# Section 5.
def offer(port: int, *addresses: str) -> bytes:
    body = struct.pack("<H", port)
    for text in addresses:
        address = ipaddress.ip_address(text)
        body += bytes([address.version]) + address.packed
    return body


def vectors() -> dict[str, object]:
    link_key, tag = bytes(range(32)), bytes(range(200, 232))
    frames = [
        ("data", data(5, 7 * SPAN + 0x123456, b"\x02ab"), True),
        ("lazy data", data(0, 0, b"\x01\x04", lazy=True), True),
        ("an acknowledgement", b"\x12\xff\x01\x21\x07", True),
        ("a ping", b"\x13", True),
        ("a close", b"\x14\x00", True),
        ("an offer", b"\x15" + offer(7460, "192.168.7.2"), True),
        ("data without bytes", data(1, 5, b""), False),
        ("an acknowledgement that is too short", b"\x12\x00\x00\x00", False),
        ("an acknowledgement that is too long", b"\x12\x00\x00\x00\x00\x00", False),
        ("a ping with a body", b"\x13\x00", False),
        ("a ping with a lane", b"\x33", False),
        ("an acknowledgement with a lane", b"\x32\x00\x00\x00\x00", False),
        ("a close without a reason", b"\x14", False),
        ("an unknown kind", b"\x16\x00", False),
        ("no kind", b"", False),
    ]
    before = [(SPAN - 3, 0), (SPAN - 3, 5)]
    positions = [(0, 0), (5, 0), *before, (SPAN - 3, SPAN + 5), (5, SPAN - 3), (5, 3 * SPAN - 3), (77, 9 * SPAN)]
    short, long = b"four", bytes(range(200))
    # Data of one lane in the order of arrival, and the batches, or `null` if it ends the link.
    streams: list[tuple[str, list[bytes], list[bytes] | None]] = [
        ("one batch", [data(5, 0, with_length(short))], [short]),
        ("two lengths", [data(5, 0, with_length(short) + with_length(long))], [short, long]),
        ("a length of two bytes where one would do", [data(5, 0, b"\x80\x04" + short)], [short]),
        ("three parts in another order", [data(5, 3, b"ur"), data(5, 0, b"\x04f"), data(5, 2, b"o")], [short]),
        ("parts that overlap", [data(5, 0, b"\x04fo"), data(5, 1, b"four"), data(5, 0, b"\x04four")], [short]),
        ("other bytes at a position that is past", [data(5, 0, with_length(short)), data(5, 1, b"FOUR\x04")], [short]),
        ("the same bytes early, twice", [data(5, 3, b"ur"), data(5, 2, b"our"), data(5, 0, b"\x04f")], [short]),
        ("other bytes at a position that is kept", [data(5, 3, b"ur"), data(5, 2, b"oUr")], None),
        ("an early byte at the limit", [data(5, MAX_EARLY - 1, b"x"), data(5, 0, with_length(short))], [short]),
        ("an early byte beyond the limit", [data(5, MAX_EARLY, b"x")], None),
        ("bytes from before the beginning", [data(5, SPAN - 1, b"\x00\x04four")], None),
        ("an empty batch", [data(5, 0, b"\x00")], None),
        ("an empty batch with a length of two bytes", [data(5, 0, b"\x80\x00")], None),
        ("a batch that is too large", [data(5, 0, bytes([0x80 | (MAX_BATCH + 1) >> 8, (MAX_BATCH + 1) & 0xFF]))], None),
    ]
    addresses = ["192.168.7.2", "2001:db8::1", "10.0.0.1"]
    offers: list[tuple[str, bytes, list[str] | None]] = [
        ("no address", offer(7460), []),
        ("three addresses", offer(7460, *addresses), addresses),
        ("port 0", offer(0, *addresses), []),
        ("one address eight times", offer(7460, *["10.0.0.1"] * 8), ["10.0.0.1"]),
        ("nine addresses", offer(7460, *["10.0.0.1"] * 9), None),
        ("half an address", offer(7460, *addresses)[:-1], None),
        ("an unknown kind", offer(7460) + b"\x05\x01\x01\x01\x01", None),
        ("half a port", b"\x24", None),
    ]
    return {
        "any_key": link_key.hex(),
        "any_tag": tag.hex(),
        "dialler_ephemeral": bytes(range(1, 33)).hex(),
        "listener_ephemeral": bytes(range(101, 133)).hex(),
        "connections": [connection(dialler, link_key, tag) for dialler in ("opener", "acceptor")],
        "frames": [{"case": case, "frame": frame.hex(), "is_valid": is_valid} for case, frame, is_valid in frames],
        "positions": [{"lower": lower, "next": at, "position": restored(lower, at)} for lower, at in positions],
        "streams": [
            {
                "case": case,
                "frames": [frame.hex() for frame in arrived],
                "batches": None if batches is None else [batch.hex() for batch in batches],
            }
            for case, arrived, batches in streams
        ],
        "offers": [{"case": case, "body": body.hex(), "addresses": found} for case, body, found in offers],
    }


if __name__ == "__main__":
    main(__doc__, {VECTORS / "version-1.json": vectors})
