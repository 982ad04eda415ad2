"""Measures the cost of lanes compared with a plain link, on a real kernel's stack without a pace.

There the emulated processor is the limit, so all work of a router is visible.
"""

import itertools
import json
import statistics
import tempfile
from pathlib import Path

import zenoh
from comparison import ratio
from goodput import put_rate
from guest import CLOCK, figures_of, set_pace
from robots import Robot, RobotError, wait_until
from round_trip import ask
from table import Table

ROUNDS = 7
BULK_BYTES, PUT_BYTES = 500_000, [1000, 100_000]
QUERIES = 80
PAYLOAD = bytes(64)
# The name of the dialled robot, the adapters, the options for dialling.
LINKS = {"lanes": ("wombat-1", "hci0", "hci1", ""), "plain": ("wombat-3", "hci2", "hci3", "#plain=true")}


def run() -> Table:
    all_rounds = figures_of("lanes_cost", 1200, controllers=4)
    rounds = [figures for figures in all_rounds if figures["plain"]]
    if not rounds:
        raise SystemExit("lanes_cost: the plain link lost messages in every round, so there is nothing to compare with")
    table = Table(
        "The cost of lanes compared with a plain link, on a real kernel's stack without a pace",
        ["what", *LINKS, "lanes to plain", "target"],
    )
    for what in rounds[0]["lanes"]:
        lanes, plain = ([figures[link][what] for figures in rounds] for link in LINKS)
        unit, target = ("ms", "at most 1.10") if what.startswith("round trip") else ("kB/s", "at least 0.85")
        cells = (f"{statistics.median(values):.1f} {unit}" for values in (lanes, plain))
        table.add(what, *cells, ratio(lanes, plain), target)
    table.notes = [
        f"Medians of {ROUNDS} alternating rounds; the ratio is the median of the rounds' ratios, with the range of "
        "the middle half in brackets. Throughput: stock clients, from the first put to the last arrival. Round trip: "
        f"{QUERIES} queries of {len(PAYLOAD)} bytes each.",
        f"In {len(all_rounds) - len(rounds)} of {len(all_rounds)} rounds the plain link lost messages (the kernel "
        "drops what a router does not read in time); these rounds are left out. Lanes lost none.",
        CLOCK,
    ]
    return table


def in_guest() -> None:
    set_pace(["hci0", "hci1", "hci2", "hci3"], 0)
    with tempfile.TemporaryDirectory() as folder:
        robots = {link: linked(link, Path(folder)) for link in LINKS}
        for n in range(ROUNDS):
            print(f"  round {n + 1} of {ROUNDS}", flush=True)
            # The links alternate in going first.
            order = list(LINKS) if n % 2 else list(reversed(LINKS))
            figures = {link: measured_or_lost(link, *robots[link]) for link in order}
            print(json.dumps(figures), flush=True)
        for robot in itertools.chain.from_iterable(robots.values()):
            robot.stop()


def linked(link: str, folder: Path) -> tuple[Robot, Robot]:
    name, near, far, options = LINKS[link]
    one = Robot(name, near, folder / f"{near}.log").start([])
    two = Robot(f"{name}-far", far, folder / f"{far}.log").start([f"ble/{name}{options}"])
    wait_until(f"linked: {link}", 30, lambda: bool(one.ble_links() and two.ble_links()))
    return one, two


def measured_or_lost(link: str, one: Robot, two: Robot) -> dict[str, float] | None:
    """Returns None if messages were lost, as happens on a plain link, but not on lanes."""
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
        times = query_times_ms(here, there)
    return rates | {"round trip, p50": statistics.median(times), "round trip, mean": statistics.mean(times)}


def query_times_ms(here: zenoh.Session, there: zenoh.Session) -> list[float]:
    key = "rect/wombat-2/bench"
    service = there.declare_queryable(key, lambda query: query.reply(key, PAYLOAD))
    querier = here.declare_querier(key, timeout=5)
    times = ask(querier, PAYLOAD, QUERIES)
    service.undeclare()
    return times
