"""What lanes cost where the link is not the limit: a plain link beside them on a real kernel's stack without a pace.

There the emulated processor is the limit, and whatever a router does shows in full.
"""

import json
import statistics
import tempfile
from pathlib import Path

import zenoh
from goodput import put_rate
from guest import CLOCK, figures_of, set_pace
from robots import Robot, RobotError, wait_until
from round_trip import ask
from table import Table
from turns import ratio

ROUNDS = 7
BULK_BYTES, PUT_BYTES = 500_000, [1000, 100_000]
ASKED = 80
PAYLOAD = bytes(64)
# The name of the dialled robot, the adapters, the options of the dial.
LINKS = {"lanes": ("wombat-1", "hci0", "hci1", ""), "plain": ("wombat-3", "hci2", "hci3", "#plain=true")}


def run() -> Table:
    figures = figures_of("lanes_cost", 1200, controllers=4)
    rounds = [one for one in figures if one["plain"]]
    if not rounds:
        raise SystemExit("lanes_cost: the plain link lost messages in every round: there is nothing to compare with")
    table = Table(
        "What lanes cost on a link that is not the limit: beside a plain link, on a real kernel's stack without a pace",
        ["what", *LINKS, "lanes to plain", "wanted"],
    )
    for what in rounds[0]["lanes"]:
        lanes, plain = ([one[link][what] for one in rounds] for link in LINKS)
        unit, wanted = ("ms", "at most 1.10") if what.startswith("round trip") else ("kB/s", "at least 0.85")
        cells = (f"{statistics.median(values):.1f} {unit}" for values in (lanes, plain))
        table.add(what, *cells, ratio(lanes, plain), wanted)
    table.notes = [
        f"Medians of {ROUNDS} rounds by turns; the ratio is the median of the rounds' own, its middle half in "
        f"brackets. Throughput: stock clients, from the first put to the last arrival. Round trip: {ASKED} queries "
        f"of {len(PAYLOAD)} bytes each.",
        f"In {len(figures) - len(rounds)} of {len(figures)} rounds the plain link lost messages (the kernel drops what "
        "a router does not read in time); they are left out. Lanes lost none.",
        CLOCK,
    ]
    return table


def in_guest() -> None:
    set_pace(["hci0", "hci1", "hci2", "hci3"], 0)
    with tempfile.TemporaryDirectory() as folder:
        robots = {link: linked(link, Path(folder)) for link in LINKS}
        for n in range(ROUNDS):
            print(f"  round {n + 1} of {ROUNDS}", flush=True)
            # By turns in going first.
            order = list(LINKS) if n % 2 else list(reversed(LINKS))
            figures = {link: measured_or_lost(link, *robots[link]) for link in order}
            print(json.dumps(figures), flush=True)
        for robot in (robot for two in robots.values() for robot in two):
            robot.stop()


def linked(link: str, folder: Path) -> tuple[Robot, Robot]:
    name, near, far, options = LINKS[link]
    one = Robot(name, near, folder / f"{near}.log").start([])
    two = Robot(f"{name}-far", far, folder / f"{far}.log").start([f"ble/{name}{options}"])
    wait_until(f"linked: {link}", 30, lambda: bool(one.ble_links() and two.ble_links()))
    return one, two


def measured_or_lost(link: str, one: Robot, two: Robot) -> dict[str, float] | None:
    """None: a plain link loses messages now and then, which is what lanes are for."""
    try:
        return measured(one, two)
    except RobotError as error:
        if link != "plain":
            raise
        print(f"  {link}: {error}", flush=True)
        return None


def measured(one: Robot, two: Robot) -> dict[str, float]:
    with one.session() as here, two.session() as there:
        rates = {f"throughput, put {size} B": put_rate(here, there, size, BULK_BYTES) for size in PUT_BYTES}
        times = asked(here, there)
    return rates | {"round trip, p50": statistics.median(times), "round trip, mean": statistics.mean(times)}


def asked(here: zenoh.Session, there: zenoh.Session) -> list[float]:
    key = "rect/wombat-2/bench"
    service = there.declare_queryable(key, lambda query: query.reply(key, PAYLOAD))
    querier = here.declare_querier(key, timeout=5)
    times = ask(querier, PAYLOAD, ASKED)
    service.undeclare()
    return times
