"""Two robots on a real kernel's Bluetooth stack. Run by `tests/vm/test`."""

import hashlib
import json
import os
import shutil
import subprocess
import time
from pathlib import Path

import pytest
import zenoh
from conftest import exchange, guest, power, start_bluetoothd
from robots import Inbox, Robot, RobotError, wait_until

MEGABYTE = os.urandom(1_000_000)


def linked(one: Robot, two: Robot) -> bool:
    return one.ble_links() == [two.name] and two.ble_links() == [one.name]


def pair(robots) -> tuple[Robot, Robot]:
    """wombat-2 dials wombat-1 by name."""
    one, two = robots(2)
    one.start([])
    two.start([f"ble/{one.name}"])
    took = wait_until("the two are linked", 30, lambda: linked(one, two))
    print(f"linked {took:.2f} s after the second router was up")
    return one, two


def test_a_robot_is_found_by_name_and_messages_go_both_ways(robots):
    one, two = pair(robots)
    with one.session() as here, two.session() as there:
        exchange(here, there)
        service = there.declare_queryable("rect/question", lambda query: query.reply("rect/question", b"answer"))
        answers: list[bytes] = []
        deadline = time.monotonic() + 20
        while not answers and time.monotonic() < deadline:
            answers = [r.ok.payload.to_bytes() for r in here.get("rect/question", timeout=2) if r.ok is not None]
        assert answers == [b"answer"]
        service.undeclare()


def test_a_robot_is_found_by_address_and_psm(robots):
    one, two = robots(2)
    one.start([], ble_options=";psm=173")
    two.start([f"ble/{guest('adapter', 'address', 'hci0')}#psm=173"])
    wait_until("the two are linked", 30, lambda: linked(one, two))


def test_robots_that_encrypt_are_paired_once_and_linked_again_after_a_restart(robots):
    one, two = robots(2)
    one.start([], ble_options=";sec=medium")
    two.start([f"ble/{one.name}#sec=medium"], ble_options=";sec=medium")
    took = wait_until("the two are paired and linked", 30, lambda: linked(one, two))
    print(f"paired and linked after {took:.2f} s")
    paired = keys()
    assert len(paired) == 2, f"both remember the other: {paired}"
    for robot in (one, two):
        robot.kill()
        robot.start()
    took = wait_until("the two are linked again", 30, lambda: linked(one, two))
    print(f"linked again after {took:.2f} s")
    with one.session() as here, two.session() as there:
        exchange(here, there)
    assert keys() == paired, "they were paired anew"


def keys() -> dict[str, list[str]]:
    """The keys of all that are paired, by the file where bluetoothd keeps them."""
    infos = {str(file): file.read_text().splitlines() for file in Path("/var/lib/bluetooth").glob("*/*/info")}
    keys = {file: [line for line in lines if line.startswith("Key=")] for file, lines in infos.items()}
    return {file: lines for file, lines in keys.items() if lines}


@pytest.mark.parametrize("bytes_per_s", [100_000, 0])
def test_a_megabyte_arrives_intact(robots, bytes_per_s):
    one, two = pair(robots)
    paced(bytes_per_s)
    try:
        with one.session() as here, two.session() as there:
            inbox = Inbox(there, "rect/bulk", here)
            here.put("rect/bulk", MEGABYTE, congestion_control=zenoh.CongestionControl.BLOCK)
            [received] = inbox.take(1)
            assert hashlib.sha256(received).digest() == hashlib.sha256(MEGABYTE).digest()
    finally:
        paced(0)


@pytest.mark.parametrize("bytes_per_s", [100_000, 0])
def test_a_receiver_that_freezes_for_a_while_loses_nothing(robots, bytes_per_s):
    one, two = pair(robots)
    paced(bytes_per_s)
    messages = [b"%d " % n + bytes(900) for n in range(500)]
    try:
        with one.session() as here, two.session() as there:
            inbox = Inbox(there, "rect/frozen", here)
            for message in messages:
                here.put("rect/frozen", message, congestion_control=zenoh.CongestionControl.BLOCK)
                if message is messages[50]:
                    two.freeze()
            # How long it is frozen is what this test is about (less than Zenoh's lease); nothing is waited for.
            time.sleep(5)
            two.thaw()
            assert inbox.take(len(messages)) == messages
    finally:
        two.thaw()
        paced(0)
    assert (one.log() + two.log()).count("linked with") == 2, "it was one link throughout"


def paced(bytes_per_s: int) -> None:
    """Both radios send so fast; 0: as fast as the emulation goes."""
    for adapter in ("hci0", "hci1"):
        guest("room", "pace", adapter, str(bytes_per_s))


@pytest.mark.parametrize(("who", "away_s"), [("listener", 0.3), ("listener", 10), ("dialler", 0.3), ("dialler", 10)])
def test_a_killed_peer_is_linked_again_when_it_is_back(robots, who, away_s):
    listener, dialler = pair(robots)
    gone, stays = (listener, dialler) if who == "listener" else (dialler, listener)
    with stays.session() as there:
        gone.kill()
        wait_until("the end is noticed", 30, lambda: not stays.ble_links())
        # How long it is away is what this test is about; nothing is waited for.
        time.sleep(away_s)
        restarted = time.monotonic()
        gone.start()
        up_s = time.monotonic() - restarted
        with gone.session() as here:
            Inbox(there, "rect/again", here).close()
            message_s = time.monotonic() - restarted
            print(f"the {who} is up {up_s:.2f} s after its restart, its first message there at {message_s:.2f} s")


def test_a_link_lost_without_a_word_is_made_again(robots):
    one, two = pair(robots)
    with one.session() as here, two.session() as there:
        inbox = Inbox(there, "rect/again", here)
        for _ in range(3):
            links = one.log().count("linked with")
            guest("room", "drop", "hci0")
            took = wait_until("the two are linked again", 30, lambda n=links: one.log().count("linked with") > n)
            reached = inbox.wait_until_reached(here)
            print(f"linked again {took:.2f} s after the loss, first message {reached:.2f} s later")


def test_an_adapter_switched_off_and_on_is_linked_again(robots):
    one, two = pair(robots)
    with one.session() as here, two.session() as there:
        inbox = Inbox(there, "rect/again", here)
        power("hci0", "off")
        wait_until("the end is noticed", 30, lambda: not one.ble_links() and not two.ble_links())
        power("hci0", "on")
        print(f"first message {inbox.wait_until_reached(here):.2f} s after the adapter was on")


def test_a_scan_lists_who_listens(robots):
    (one,) = robots(1)
    one.start([], ble_options=";fleet=lions")
    command = [os.environ["RECT_ROUTER"], "scan", "--adapter", "hci1", "--seconds", "5", "--fleet", "lions", "--json"]
    scan = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert scan.returncode == 0, scan.stderr
    (heard,) = json.loads(scan.stdout)
    assert heard["address"] == guest("adapter", "address", "hci0")
    assert (heard["name"], heard["fleet"]) == (one.name, "lions")


def test_adapters_that_come_back_under_other_numbers_are_linked_again(robots):
    one, two = pair(robots)
    addresses = [guest("adapter", "address", f"hci{n}") for n in range(2)]
    with one.session() as here, two.session() as there:
        inbox = Inbox(there, "rect/again", here)
        try:
            for name, address in zip(guest("room", "swap", "hci0", "hci1").split(), addresses, strict=True):
                guest("adapter", "wait", name)
                assert guest("adapter", "address", name) == address
            print(f"first message {inbox.wait_until_reached(here):.2f} s after both adapters were on")
        finally:
            guest("room", "swap", "hci0", "hci1")


def test_a_computer_that_slept_is_linked_again(robots):
    one, two = pair(robots)
    with one.session() as here, two.session() as there:
        inbox = Inbox(there, "rect/again", here)
        # The kernel tells Bluetooth to go to sleep, freezes all processes for 5 s, and wakes everything up.
        Path("/sys/power/pm_test").write_text("freezer")
        Path("/sys/power/state").write_text("freeze")
        print(f"first message {inbox.wait_until_reached(here):.2f} s after the sleep")


def test_a_clock_that_is_set_leaves_the_link_alone(robots):
    one, two = pair(robots)
    with one.session() as here, two.session() as there:
        inbox = Inbox(there, "rect/again", here)
        now = time.time()
        try:
            for years in (10, -1):
                time.clock_settime(time.CLOCK_REALTIME, now + years * 365 * 86400)
                inbox.wait_until_reached(here)
        finally:
            time.clock_settime(time.CLOCK_REALTIME, now)
        assert one.log().count("linked with") == 1, "still the first link"


def test_a_router_that_may_asks_for_a_connections_timing(robots):
    folder = Path("/sys/kernel/debug/bluetooth/hci0")
    figures = {"conn_min_interval": 24, "conn_max_interval": 40, "supervision_timeout": 42}
    # Linux's own; the longest interval first, as it may not be under the shortest.
    for name in sorted(figures):
        (folder / name).write_text(str(figures[name]))
    pair(robots)
    assert [int((folder / name).read_text()) for name in figures] == [6, 12, 200]


def test_bluetoothd_killed_while_linked_leaves_the_link_alone_and_a_later_one_possible(robots):
    one, two = pair(robots)
    with one.session() as here, two.session() as there:
        inbox = Inbox(there, "rect/again", here)
        guest("bluetoothd", "kill")
        start_bluetoothd()
        inbox.wait_until_reached(here)
        two.kill()
        wait_until("the end is noticed", 30, lambda: not one.ble_links())
        two.start()
        wait_until("the two are linked again", 60, lambda: linked(one, two))


def test_bluetoothd_killed_while_idle_is_no_end_of_listening_nor_of_dialling(robots):
    one, two = robots(2)
    one.start([])
    two.start(["ble/nobody"])
    guest("bluetoothd", "kill")
    start_bluetoothd()
    wait_until("the listener is back", 30, lambda: one.log().count("listens on hci0") == 2)
    two.kill()
    two.start([f"ble/{one.name}"])
    wait_until("the two are linked", 60, lambda: linked(one, two))


def test_two_robots_that_dial_each_other_at_once_end_as_one_link(robots):
    one, two = robots(2)
    for _ in range(5):
        one.start([f"ble/{two.name}"], wait=False)
        two.start([f"ble/{one.name}"])
        one.wait_until_up()
        wait_until("the two are linked", 30, lambda: linked(one, two))
        with one.session() as here, two.session() as there:
            Inbox(there, "rect/once", here).close()
            Inbox(here, "rect/back", there).close()
        assert linked(one, two), "still one link"
        one.kill()
        two.kill()


def test_a_name_nobody_advertises_keeps_the_router_running(robots):
    (one,) = robots(1)
    one.start(["ble/nobody"])
    with one.session() as here, one.session() as there:
        Inbox(there, "rect/local", here).close()


def test_an_adapter_that_is_missing_or_off_ends_the_router_with_its_reason(robots, tmp_path):
    missing = Robot("wombat-9", "hci9", tmp_path / "missing.log")
    with pytest.raises(RobotError):
        missing.start([])
    assert "there is no bluetooth adapter hci9: there is hci0, hci1" in missing.log()
    power("hci1", "off")
    off = Robot("wombat-8", "hci1", tmp_path / "off.log")
    with pytest.raises(RobotError):
        off.start([])
    power("hci1", "on")
    assert "hci1 is switched off: run `bluetoothctl power on`" in off.log()


def test_a_second_router_of_the_same_name_ends_with_its_reason(robots, tmp_path):
    (one,) = robots(1)
    one.start([])
    twin = Robot(one.name, "hci1", tmp_path / "twin.log")
    with pytest.raises(RobotError):
        twin.start([])
        wait_until("the twin ends", 10, lambda: twin.ended())
        raise RobotError
    assert "give one of the two another name=" in twin.log()
    assert one.ble_links() == []


def test_no_bluetoothd_ends_the_router_with_its_reason(robots):
    (one,) = robots(1)
    guest("bluetoothd", "stop")
    try:
        with pytest.raises(RobotError):
            one.start([])
        assert "bluetoothd does not answer" in one.log() and "systemctl start bluetooth" in one.log()
    finally:
        start_bluetoothd()


FORBIDDEN = """<busconfig><policy user="nobody"><deny send_destination="org.bluez"/></policy></busconfig>"""


def test_a_user_who_may_not_use_bluetooth_is_told_how_to_be_let_in():
    policy = Path("/etc/dbus-1/system.d/forbidden.conf")
    policy.write_text(FORBIDDEN)
    reload = [
        "dbus-send",
        "--system",
        "--print-reply",
        "--dest=org.freedesktop.DBus",
        "/",
        "org.freedesktop.DBus.ReloadConfig",
    ]
    guest(*reload)
    try:
        # Where this user can read it.
        router = shutil.copy(os.environ["RECT_ROUTER"], "/tmp/router-of-nobody")
        command = ["setpriv", "--reuid=nobody", "--regid=nogroup", "--clear-groups", router, "-l", "ble/hci0#name=x"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    finally:
        policy.unlink()
        guest(*reload)
    assert done.returncode == 1, done.stderr
    assert "sudo usermod -aG bluetooth" in done.stderr
