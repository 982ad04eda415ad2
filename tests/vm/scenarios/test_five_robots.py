"""Five adapters in one room: `tests/vm/test` runs it with five controllers."""

from robots import Inbox, wait_until


def test_a_base_with_four_robots_hears_them_all_and_they_hear_each_other(robots):
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
            inbox = Inbox(receiver, "rect/round", sender)
            for n in range(10):
                sender.put("rect/round", str(n))
            assert inbox.take(10) == [str(n).encode() for n in range(10)]
            inbox.close()
    finally:
        for session in sessions:
            session.close()


def test_one_router_uses_two_adapters_to_listen_and_to_dial(robots):
    base, _, two, three, four = robots(5)
    four.start([])
    base.start([f"ble/{four.name}#adapter=hci1"], listens=["ble/hci1#name=base-b"])
    two.start([f"ble/{base.name}"])
    three.start(["ble/base-b"])
    names = sorted(robot.name for robot in (two, three, four))
    wait_until("all are linked", 60, lambda: sorted(base.ble_links()) == names)
    with two.session() as one_end, three.session() as other_end, four.session() as third_end:
        Inbox(other_end, "rect/across", one_end).close()
        Inbox(one_end, "rect/back", other_end).close()
        Inbox(third_end, "rect/third", one_end).close()
