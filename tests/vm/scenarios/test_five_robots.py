"""Five robots in one room: `tests/vm/test` runs it with five controllers."""

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
