"""Measures the memory of a router whose neighbour is killed and started again 200 times, beside stock zenohd."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

from pairs import room
from robots import rect_settings
from room import wait_for_link
from routers import PROGRAMS, Router, own_kb
from table import Table

KILLS, EVERY = 200, 50
PDU = 251
#: How long the neighbour over TCP lives.
LIFE_S = 1.0

#: Kills the neighbour and starts it again, until it is linked.
Kill = Callable[[], None]


def run() -> Table:
    columns = [*(f"{kills} times" for kills in range(0, KILLS + 1, EVERY))]
    table = Table("Private memory of a router whose neighbour was killed", ["router, link", *columns])
    cases = {f"{program}, TCP": over_tcp(program) for program in PROGRAMS}
    cases["rect-router, Bluetooth"] = over_bluetooth()
    rows: dict[str, list[str]] = {}
    threads = [threading.Thread(target=measure, args=(title, case, rows)) for title, case in cases.items()]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for title in cases:
        table.add(title, *rows[title])
    table.notes = [
        "Heap and stacks. All three pairs at the same time; Bluetooth is the simulated air. The neighbour ends at "
        "once, as in a power cut, and links again with a new id.",
    ]
    return table


def measure(title: str, case: Iterator[tuple[int, Kill]], rows: dict[str, list[str]]) -> None:
    pid, kill = next(case)
    sizes = [own_kb(pid)]
    for number in range(1, KILLS + 1):
        kill()
        if number % EVERY == 0:
            sizes.append(own_kb(pid))
    rows[title] = [f"{kb / 1000:.2f} MB" for kb in sizes]
    for _ in case:
        pass


def over_tcp(program: str) -> Iterator[tuple[int, Kill]]:
    with Router(program) as router:

        def kill() -> None:
            with Router(program, "-e", router.endpoint) as neighbour:
                time.sleep(LIFE_S)
                neighbour.kill()

        kill()
        yield router.pid, kill


def over_bluetooth() -> Iterator[tuple[int, Kill]]:
    with room(PDU) as air:
        one, two = (air.add_robot(name, arguments=tuple(rect_settings({"robot": name}))) for name in ("one", "two"))
        wait_for_link(one, two)

        def kill() -> None:
            two.kill()
            two.start()
            wait_for_link(one, two)

        yield one.pid(), kill
