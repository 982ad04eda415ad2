"""Five adapters in range of each other. Run by `tests/vm/test` with five controllers."""

from robots import Collector, wait_until


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
