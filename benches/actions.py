"""Measures actions over Bluetooth, on the simulated air, and over a TCP link slowed to its rate, beside a service and a
message of plain Zenoh: from `start` to the handler, from `cancel` to the handler, alone and beside a transfer of 1 MB,
and what a goal with 10 feedbacks a second costs."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass

import rect
import zenoh
from comparison import rounds
from logs import PDU
from pairs import carried, linked_robots, room
from parameters import LARGE
from robots import open_client, wait_until
from state import RATE_BYTES_PER_S, routers
from table import Table
from traffic import percentile

GOALS = rounds(100)
BESIDE = rounds(30)
#: How long the goal with feedback runs, in seconds, and how often it reports.
FEEDBACK_S, FEEDBACK_PER_S = 10.0, 10
TIMEOUT_S = 30.0


@dataclass
class Link:
    """Two routers with a slow link between them."""

    near: str
    far: str
    carried: Callable[[], int]
    """Returns the bytes that the link has carried so far, in both directions."""


class Arrivals:
    """When something has arrived at the handler."""

    def __init__(self) -> None:
        self._arrived = threading.Condition()
        self._at: float | None = None

    def arrive(self) -> None:
        with self._arrived:
            self._at = time.monotonic()
            self._arrived.notify_all()

    def after(self, call: Callable[[], object]) -> float:
        """Returns how long after the beginning of the call it has arrived, in ms."""
        with self._arrived:
            self._at = None
        began = time.monotonic()
        call()
        with self._arrived:
            assert self._arrived.wait_for(lambda: self._at is not None, TIMEOUT_S)
            assert self._at is not None
            return (self._at - began) * 1000


@contextmanager
def over_bluetooth() -> Iterator[Link]:
    with room(PDU) as air:
        near, far = linked_robots(air)
        yield Link(near, far, lambda: carried(air))


@contextmanager
def over_tcp() -> Iterator[Link]:
    with routers() as (shaper, near, far):
        yield Link(near, far, lambda: shaper.carried)


@dataclass
class Peer:
    start: Callable[[], None]
    """Starts a goal, and returns when it is accepted."""
    cancel: Callable[[], None]
    """Cancels it, and returns when it has ended."""
    started: Arrivals
    cancelled: Arrivals


def has_action(laptop: rect.Robot) -> bool:
    with suppress(rect.NoService):
        return any("dig" in program.actions for program in laptop.programs("wombat-1"))
    return False


@contextmanager
def actions(link: Link) -> Iterator[Peer]:
    started, cancelled = Arrivals(), Arrivals()
    with rect.connect("wombat-1", router=link.near) as robot, rect.connect("wombat-2", router=link.far) as laptop:
        laptop.wait_for_peer("wombat-1", TIMEOUT_S)

        @robot.action("dig")
        def dig(goal: rect.Goal) -> None:
            started.arrive()
            try:
                while True:
                    if goal.value:
                        goal.feedback(goal.value, progress=0.5)
                    goal.sleep(1 / FEEDBACK_PER_S)
            except rect.Cancelled:
                cancelled.arrive()
                raise

        wait_until("the action is known", TIMEOUT_S, lambda: has_action(laptop))
        runs: list[rect.ActionRun] = []

        def cancel() -> None:
            run = runs.pop()
            run.cancel()
            try:
                run.result(TIMEOUT_S)
            except rect.ActionError:
                run.close()

        yield Peer(lambda: runs.append(laptop.start("wombat-1", "dig")), cancel, started, cancelled)


@contextmanager
def plain_zenoh(link: Link) -> Iterator[Peer]:
    """The usual code without actions: a queryable for the start, and a message for the cancel."""
    started, cancelled = Arrivals(), Arrivals()
    with ExitStack() as stack:
        robot = stack.enter_context(open_client(link.near))
        laptop = stack.enter_context(open_client(link.far))

        def on_start(query: zenoh.Query) -> None:
            with query:
                started.arrive()
                query.reply("rect/wombat-1/dig", "accepted")

        served = robot.declare_queryable("rect/wombat-1/dig", on_start)
        received = robot.declare_subscriber("rect/wombat-2/dig/cancel", lambda _: cancelled.arrive())
        urgent = laptop.declare_publisher("rect/wombat-2/dig/cancel", priority=zenoh.Priority.REAL_TIME, express=True)
        deadline = time.monotonic() + TIMEOUT_S
        while not urgent.matching_status.matching and time.monotonic() < deadline:
            time.sleep(0.05)
        yield Peer(lambda: list(laptop.get("rect/wombat-1/dig")), lambda: urgent.put("stop"), started, cancelled)
        received.undeclare()
        served.undeclare()


def measure(peer: Peer, count: int) -> str:
    starts, cancels = [], []
    for _ in range(count):
        starts.append(peer.started.after(peer.start))
        cancels.append(peer.cancelled.after(peer.cancel))
    quantiles = [percentile(times, share) for times in (starts, cancels) for share in (0.5, 0.99)]
    return "{:.0f}, {:.0f}; {:.0f}, {:.0f} ms".format(*quantiles)


def send_large(laptop: rect.Robot) -> None:
    # The session is closed when enough was measured.
    with suppress(rect.Closed):
        laptop.transfer("wombat-1", "large", LARGE)


def beside_transfer(link: Link, peer: Peer) -> str:
    with rect.connect("wombat-1", router=link.near) as robot, rect.connect("wombat-2", router=link.far) as laptop:
        laptop.wait_for_peer("wombat-1", TIMEOUT_S)
        with robot.receive_transfers("*/large"):
            threading.Thread(target=send_large, args=[laptop], daemon=True).start()
            time.sleep(2)
            return measure(peer, BESIDE)


def feedback_cost(link: Link) -> str:
    """Returns the bytes of a goal with feedback, and of one without."""
    costs = []
    for value in ("", "scoop 17 of 40"):
        with actions(link), rect.connect("wombat-2", router=link.far) as laptop:
            laptop.wait_for_peer("wombat-1", TIMEOUT_S)
            before = link.carried()
            run = laptop.start("wombat-1", "dig", value)
            time.sleep(FEEDBACK_S)
            run.cancel()
            costs.append((link.carried() - before) / FEEDBACK_S)
            run.close()
    return f"{costs[1]:,.0f} ({costs[0]:,.0f} without)"


def run() -> Table:
    columns = ["start; cancel (p50, p99 each)", "beside 1 MB", "bytes/s with feedback"]
    table = Table(f"Goals over a link of {RATE_BYTES_PER_S / 1000:.0f} kB/s", ["", *columns])
    for name, link_of in {"Bluetooth": over_bluetooth, "TCP": over_tcp}.items():
        with link_of() as link:
            for title, peer_of in {"actions": actions, "plain Zenoh, a query and a message": plain_zenoh}.items():
                with peer_of(link) as peer:
                    alone = measure(peer, GOALS)
                    beside = beside_transfer(link, peer)
                cost = feedback_cost(link) if peer_of is actions else "-"
                table.add(f"{name}: {title}", alone, beside, cost)
    table.notes = [
        f"From the laptop's call until the handler on the robot is called, or knows that it is cancelled: {GOALS} "
        f"goals, and {BESIDE} beside a transfer of 1 MB from the laptop to the robot. The robot's router keeps a goal "
        f"before it begins. {FEEDBACK_PER_S} feedbacks a second with a text of 14 characters, bytes both ways with the "
        "link's keep-alives. Plain Zenoh's query and message keep nothing, and do not survive a cut.",
        "Bluetooth is the simulated air, with packets of 27 bytes and a connection interval of 30 ms.",
    ]
    return table
