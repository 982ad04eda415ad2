"""Five adapters in range of each other. Run by `tests/vm/test` with five controllers."""

import platform
import re

import pytest
from conftest import guest
from robots import Collector, wait_until

KERNEL = tuple(int(part) for part in re.findall(r"\d+", platform.release())[:2])


def test_base_station_links_four_robots_that_reach_each_other(robots):
    base, *others = robots(5)
    base.start([])
    for robot in others:
        robot.start([f"ble/{base.name}"])
    names = sorted(robot.name for robot in others)
    took = wait_until("all are linked", 60, lambda: sorted(base.ble_links()) == names)
    print(f"four links after {took:.1f} s")
    sessions = [robot.session() for robot in (base, *others)]
    try:
        for sender, receiver in zip(sessions, [*sessions[1:], sessions[0]], strict=True):
            collector = Collector(receiver, "rect/round", sender)
            for n in range(10):
                sender.put("rect/round", str(n))
            assert collector.take(10) == [str(n).encode() for n in range(10)]
            collector.close()
    finally:
        for session in sessions:
            session.close()


def test_one_router_listens_and_dials_on_two_adapters(robots):
    base, _, two, three, four = robots(5)
    four.start([])
    base.start([f"ble/{four.name}#adapter=hci1"], listens=["ble/hci1#name=base-b"])
    two.start([f"ble/{base.name}"])
    three.start(["ble/base-b"])
    names = sorted(robot.name for robot in (two, three, four))
    wait_until("all are linked", 60, lambda: sorted(base.ble_links()) == names)
    with two.session() as one_end, three.session() as other_end, four.session() as third_end:
        Collector(other_end, "rect/across", one_end).close()
        Collector(one_end, "rect/back", other_end).close()
        Collector(third_end, "rect/third", one_end).close()


def test_robot_that_is_dialled_dials_with_another_interval(robots):
    hub, dialled, dialling, *_ = robots(5)
    hub.start([f"ble/{dialled.name}"])
    dialling.start([f"ble/{hub.name}"])
    wait_until("the first link", 60, lambda: hub.ble_links() == [dialling.name])
    dialled.start([])
    wait_until("both links", 60, lambda: len(hub.ble_links()) == 2)
    # In units of 1.25 ms, as the controllers report them. RECT prefers 12.
    assert intervals("hci2") == [12]
    (other,) = intervals("hci1")
    assert other != 12 and sorted(intervals("hci0")) == sorted([12, other])


@pytest.mark.skipif(KERNEL < (6, 11), reason=f"Linux {KERNEL} changes the interval of a link when it is opened again")
def test_interval_changes_while_the_link_is_open(robots):
    hub, dialled, dialling, *_ = robots(5)
    dialled.start([])
    hub.start([f"ble/{dialled.name}"])
    wait_until("the first link", 60, lambda: hub.ble_links() == [dialled.name])
    # This robot learns only in the handshake which interval the hub uses.
    dialling.start([f"ble/{hub.name}"])
    wait_until("both links", 60, lambda: len(hub.ble_links()) == 2)
    wait_until("different intervals", 20, lambda: len(set(intervals("hci0"))) == 2)


def intervals(adapter: str) -> list[int]:
    """Returns the connection intervals of an adapter's links in their order."""
    (text,) = re.findall(rf"{adapter}: .*?intervals \[(.*?)\]", guest("room", "list"))
    return [int(interval) for interval in text.split()]
