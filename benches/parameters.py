"""Compares parameters with NetworkTables, over a TCP link slowed to the rate of Bluetooth: from a slider to the program
beside a transfer of 1 MB, bytes while nothing changes, and a restart, a cut and an invalid value."""

import os
import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import ntcore
import rect
from comparison import rounds
from robots import free_port, is_listening, wait_until
from shaper import Shaper
from state import RATE_BYTES_PER_S, routers
from table import Table

PARAMETERS = 30
CHANGES = rounds(100)
#: The interval at which a slider sends, in seconds.
EVERY_S = 0.1
LARGE = os.urandom(1_000_000)
IDLE_S = 20.0
CUT_S = 5.0


class Program:
    """A program whose parameter `p0` is tuned: when it had which value."""

    def __init__(self) -> None:
        self.value = 0.0
        self._changed = threading.Condition()

    def on_value(self, value: float) -> None:
        with self._changed:
            self.value = value
            self._changed.notify_all()

    def until(self, value: float, timeout: float) -> float | None:
        """Returns how long it took to get a value."""
        began = time.monotonic()
        with self._changed:
            arrived = self._changed.wait_for(lambda: self.value == value, timeout)
        return time.monotonic() - began if arrived else None


@dataclass
class Peer:
    """A robot that is tuned from a laptop."""

    shaper: Shaper
    program: Program
    set: Callable[[object], str]
    """Sets the parameter from the laptop, and returns what the laptop learns."""
    send_large: Callable[[], None]
    """Begins to send 1 MB from the laptop to the robot."""
    restart: Callable[[], float]
    """Restarts the program, and returns the value of the parameter."""


@contextmanager
def parameters() -> Iterator[Peer]:
    with (
        tempfile.TemporaryDirectory() as folder,
        routers() as (shaper, near, far),
        rect.connect("wombat-2", router=far) as laptop,
    ):
        program = Program()
        declared = {f"p{n}": rect.Number(0, min=0, max=1000) for n in range(PARAMETERS)}
        options = rect.GroupOptions(file=Path(folder) / "drive.json")

        def start() -> tuple[rect.Robot, rect.ParameterGroup]:
            robot = rect.connect("wombat-1", router=near)
            group = robot.parameters("drive", options, **declared)
            group.on_change(lambda _change: program.on_value(group.p0))
            return robot, group

        robot, group = start()
        transfers = robot.receive_transfers("*/large", folder=folder)
        laptop.wait_for_peer("wombat-1", 20)

        def set_value(value: object) -> str:
            try:
                laptop.set_parameters("wombat-1", "drive", p0=value)
            except rect.RectError as error:
                return type(error).__name__
            return "in force"

        def restart() -> float:
            nonlocal robot, group
            robot.close()
            robot, group = start()
            return float(group.p0)

        yield Peer(shaper, program, set_value, lambda: start_transfer(laptop), restart)
        transfers.close()
        robot.close()


def start_transfer(laptop: rect.Robot) -> None:
    thread = threading.Thread(target=lambda: laptop.transfer("wombat-1", "large", LARGE), daemon=True)
    thread.start()


@contextmanager
def network_tables() -> Iterator[Peer]:
    with tempfile.TemporaryDirectory() as folder:
        program, port = Program(), free_port()
        persistent = str(Path(folder) / "networktables.json")

        def start() -> tuple[ntcore.NetworkTableInstance, list[ntcore.DoubleEntry]]:
            server = ntcore.NetworkTableInstance.create()
            server.startServer(persist_filename=persistent, listen_address="127.0.0.1", port3=free_port(), port4=port)
            wait_until("the server is up", 20, lambda: is_listening(port))
            entries = [server.getDoubleTopic(f"/p{n}").getEntry(0.0) for n in range(PARAMETERS)]
            for entry in entries:
                entry.setDefault(0.0)
                entry.getTopic().setPersistent(True)
            flags = ntcore.EventFlags.kValueAll
            server.addListener(entries[0], flags, lambda event: program.on_value(event.data.value.getDouble()))
            return server, entries

        server, entries = start()
        client = ntcore.NetworkTableInstance.create()
        with Shaper(RATE_BYTES_PER_S, port) as shaper:
            client.startClient4("laptop")
            client.setServer("127.0.0.1", shaper.port)
            wait_until("the client is connected", 20, client.isConnected)
            publisher = client.getDoubleTopic("/p0").publish()
            texts: list[ntcore.StringPublisher] = []
            large = client.getRawTopic("/large").publish("bytes")

            def set_value(value: object) -> str:
                if isinstance(value, str):
                    texts.append(client.getStringTopic("/p0").publish())
                    texts[-1].set(value)
                else:
                    publisher.set(float(value))
                client.flush()
                return "nothing"

            def restart() -> float:
                nonlocal server, entries
                # It writes the file once a second.
                time.sleep(3)
                server.stopServer()
                server, entries = start()
                time.sleep(1)
                return entries[0].get()

            yield Peer(shaper, program, set_value, lambda: large.set(LARGE), restart)
            client.stopClient()
            server.stopServer()


PEERS = {"RECT, parameters": parameters, "NetworkTables (pyntcore), persistent topics": network_tables}


def delays(peer: Peer) -> list[float | None]:
    """Moves the slider, and returns how long each value took to the program."""
    found = []
    for number in range(CHANGES):
        # 1 to 1000: another value each time.
        value = float(number % 999 + 1)
        began = time.monotonic()
        peer.set(value)
        called = time.monotonic() - began
        waited = peer.program.until(value, 60)
        # The call of RECT returns when the value is in force.
        found.append(None if waited is None else called + waited)
        time.sleep(max(EVERY_S - (time.monotonic() - began), 0))
    return found


def measured(peer: Peer) -> list[str]:
    peer.set(1000.0)
    time.sleep(2)
    before = peer.shaper.carried
    time.sleep(IDLE_S)
    idle = peer.shaper.carried - before
    alone = delays(peer)
    peer.send_large()
    time.sleep(0.5)
    beside = delays(peer)
    time.sleep(30)
    peer.set(500.0)
    time.sleep(2)
    restarted = "kept" if peer.restart() == 500.0 else "lost"
    time.sleep(3)
    invalid = peer.set("fast")
    # The laptop sets a value that does not arrive, and the robot's program goes on.
    peer.shaper.state = "off"
    time.sleep(1)
    answered = threading.Event()
    learned = []

    def set_during_cut() -> None:
        learned.append(peer.set(700.0))
        answered.set()

    threading.Thread(target=set_during_cut, daemon=True).start()
    time.sleep(CUT_S)
    peer.shaper.state = "on"
    answered.wait(20)
    time.sleep(5)
    came = "came later" if peer.program.value == 700.0 else "did not come"
    return [quantiles(alone), quantiles(beside), f"{idle:,}", restarted, f"{came}; {learned[0]}", invalid]


def quantiles(times: list[float | None]) -> str:
    known = sorted(one for one in times if one is not None)
    if not known:
        return "never"
    p99 = known[min(len(known) - 1, round(0.99 * (len(known) - 1)))]
    missing = f", {len(times) - len(known)} never" if len(known) < len(times) else ""
    return f"{statistics.median(known) * 1000:,.0f}, {p99 * 1000:,.0f} ms{missing}"


def run() -> Table:
    columns = ["", "slider", "beside 1 MB", "idle bytes", "restart", "set during a cut", "a text for a number"]
    table = Table(f"{PARAMETERS} parameters over a link of {RATE_BYTES_PER_S / 1000:.0f} kB/s", columns)
    for name, peer in PEERS.items():
        with peer() as running:
            table.add(name, *measured(running))
        print(f"  {name}", flush=True)
    table.notes = [
        f"Slider: {CHANGES} values, one every {EVERY_S:.1f} s, from the laptop's call until the program's callback: "
        "p50, p99. Beside a transfer of 1 MB from the laptop to the robot. Idle bytes: what the link carries in "
        f"{IDLE_S:.0f} s, with its keep-alives. The cut ends the connections for {CUT_S:.0f} s, and the laptop sets a "
        "value meanwhile: whether it arrives later, and how its library answers.",
    ]
    return table
