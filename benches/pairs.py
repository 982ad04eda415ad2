"""Provides two routers with one slow link between them, for the benches of slow links."""

import re
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import zenoh
from robots import PluginRobot, Robot, open_client, rect_settings, wait_until
from room import Room, wait_for_link
from routers import Router, status
from shaper import Shaper
from zenoh import CongestionControl

PEERS = ["lanes", "plain link", "stock over TCP"]
INTERVAL_MS = 30


@dataclass
class Pair:
    near: Callable[[], zenoh.Session]
    """Opens a client of one router, whose messages cross the link."""
    far: Callable[[], zenoh.Session]
    """Opens a client of the other router."""
    far_socket: str
    """A local socket of the other router, for one more program; it buffers little that is not read."""
    carried: Callable[[], int]
    """Returns the bytes that the link carried so far, in both directions."""
    links: Callable[[], int]
    """Returns how often the link was established."""
    complaints: Callable[[], list[str]]
    """Returns the warnings and errors of the routers."""
    pids: list[int]

    def memory_mb(self, field: str) -> list[float]:
        """Returns VmRSS or VmHWM of each router, in MB."""
        return [status(pid, field) / 1000 for pid in self.pids]


@contextmanager
def pair(peer: str, pdu: int, raw_bytes_per_s: float, *settings: str) -> Iterator[Pair]:
    """Runs one of `PEERS`, or `plugin` (lanes in stock zenohds with our plugin), with `settings` in the form of
    `--cfg`."""
    arguments = tuple(part for setting in settings for part in ("--cfg", setting))
    with tempfile.TemporaryDirectory() as folder:
        if peer == "stock over TCP":
            with tcp_pair(raw_bytes_per_s, Path(folder), arguments) as made:
                yield made
        else:
            kind = PluginRobot if peer == "plugin" else Robot
            with ble_pair(pdu, "#plain=true" if peer == "plain link" else "", Path(folder), arguments, kind) as made:
                yield made


def room(pdu: int) -> Room:
    return Room("desk", "--pdu", str(pdu), "--interval", f"{INTERVAL_MS}ms")


@contextmanager
def ble_pair(
    pdu: int, dial_options: str, folder: Path, arguments: tuple[str, ...], kind: type[Robot] = Robot
) -> Iterator[Pair]:
    socket = f"unixsock-stream/{folder}/far.sock"
    with room(pdu) as air:
        # The second robot dials the first one, and receives its messages.
        one = air.add_robot("wombat-1", arguments=arguments, kind=kind)
        two = air.add_robot("wombat-2", dial_options, ("-l", socket, *arguments), kind)
        wait_for_link(one, two)
        yield Pair(
            near=one.session,
            far=two.session,
            far_socket=socket,
            carried=lambda: carried(air),
            links=lambda: two.log().count("ble: linked with"),
            complaints=lambda: complaints(one.log() + two.log()),
            pids=[one.pid(), two.pid()],
        )


def declare_reached(session: zenoh.Session, key: str, congestion: CongestionControl) -> zenoh.Publisher:
    """Declares a publisher, and waits until the router knows that a subscriber matches."""
    publisher = session.declare_publisher(key, congestion_control=congestion)
    wait_until(f"a subscriber to {key} is known", 20, lambda: publisher.matching_status.matching)
    return publisher


def carried(air: Room) -> int:
    """Returns the bytes that all links in a room carried so far."""
    return sum(adapter["stats"]["sdu_bytes"] for adapter in air.status()["adapters"])


def linked_robots(air: Room) -> tuple[str, str]:
    """Starts the routers of wombat-1 and wombat-2 in a room, which are linked, and returns their endpoints."""
    one, two = (
        air.add_robot(name, arguments=tuple(rect_settings({"robot": name}))) for name in ("wombat-1", "wombat-2")
    )
    wait_for_link(one, two)
    return one.endpoint(), two.endpoint()


def ble_pair_endpoints(air: Room) -> tuple[str, str]:
    """Starts two linked routers in a room, and returns the endpoints for their programs."""
    one = air.add_robot("wombat-1")
    two = air.add_robot("wombat-2")
    wait_for_link(one, two)
    return one.endpoint(), two.endpoint()


@contextmanager
def tcp_pair(bytes_per_s: float, folder: Path, arguments: tuple[str, ...]) -> Iterator[Pair]:
    logs = [folder / "near.log", folder / "far.log"]
    socket = f"unixsock-stream/{folder}/far.sock"
    with ExitStack() as stack:
        near = stack.enter_context(Router("stock zenohd", *arguments, log=logs[0]))
        shaper = stack.enter_context(Shaper(bytes_per_s, int(near.endpoint.rsplit(":", 1)[1])))
        dial = ["-e", f"tcp/127.0.0.1:{shaper.port}", "-l", socket]
        far = stack.enter_context(Router("stock zenohd", *dial, *arguments, log=logs[1]))
        yield Pair(
            near=lambda: open_client(near.endpoint),
            far=lambda: open_client(far.endpoint),
            far_socket=socket,
            carried=lambda: shaper.carried,
            links=lambda: shaper.connections,
            complaints=lambda: complaints("".join(log.read_text() for log in logs)),
            pids=[near.pid, far.pid],
        )


def complaints(log: str) -> list[str]:
    """Returns the warnings and errors of a log, without time and module."""
    lines = [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in log.splitlines()]
    return [re.sub(r"^.*?\w: ", "", line)[:100] for line in lines if " WARN " in line or "ERROR " in line]
