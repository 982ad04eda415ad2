"""Two robots on the Bluetooth stack of a real kernel. Run by `tests/vm/test`."""

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
from robots import Collector, Robot, RobotError, wait_until

MEGABYTE = os.urandom(1_000_000)


def linked(one: Robot, two: Robot) -> bool:
    return one.ble_links() == [two.name] and two.ble_links() == [one.name]


def pair(robots) -> tuple[Robot, Robot]:
    """Links two robots: wombat-2 dials wombat-1 by name."""
    one, two = robots(2)
    one.start([])
    two.start([f"ble/{one.name}"])
    took = wait_until("the two are linked", 30, lambda: linked(one, two))
    print(f"linked {took:.2f} s after the second router started")
    return one, two


@pytest.mark.few
def test_dials_by_name_and_exchanges_messages(robots):
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


def test_dials_by_address_and_psm(robots):
    one, two = robots(2)
    one.start([], ble_options=";psm=173")
    two.start([f"ble/{guest('adapter', 'address', 'hci0')}#psm=173"])
    wait_until("the two are linked", 30, lambda: linked(one, two))


def test_pairs_once_and_reconnects_encrypted_after_a_restart(robots):
    one, two = robots(2)
    one.start([], ble_options=";sec=medium")
    two.start([f"ble/{one.name}#sec=medium"], ble_options=";sec=medium")
    took = wait_until("the two are paired and linked", 30, lambda: linked(one, two))
    print(f"paired and linked after {took:.2f} s")
    paired = keys()
    assert len(paired) == 2, f"both store the key of the other: {paired}"
    for robot in (one, two):
        robot.kill()
        robot.start()
    took = wait_until("the two are linked again", 30, lambda: linked(one, two))
    print(f"linked again after {took:.2f} s")
    with one.session() as here, two.session() as there:
        exchange(here, there)
    assert keys() == paired, "they were paired again"


@pytest.mark.parametrize("has_secret", [True, False])
def test_monitor_shows_nothing_of_a_link_with_a_secret(robots, tmp_path, has_secret):
    """btmon records everything between the kernel and the controllers. Without a secret, the search finds most of the
    fifty texts: one whose bytes are in two packets is not found."""
    secret = tmp_path / "secret"
    secret.write_text("fleet:what only the team knows\n")
    options = f";secret={secret}" if has_secret else ""
    recorded = tmp_path / "monitor.btsnoop"
    one, two = robots(2)
    monitor = subprocess.Popen(["btmon", "-w", str(recorded)], stdout=subprocess.DEVNULL)
    try:
        wait_until("the monitor records", 10, lambda: recorded.exists() and recorded.stat().st_size > 0)
        one.start([], ble_options=options)
        two.start([f"ble/{one.name}"], ble_options=options)
        wait_until("the two are linked", 30, lambda: linked(one, two))
        with one.session() as here, two.session() as there:
            exchange(here, there)
    finally:
        monitor.terminate()
        monitor.wait()
    record = recorded.read_bytes()
    assert (b"both/ways" in record) == (not has_secret)
    found = {text for n in range(50) if (text := b"message %d" % n) in record}
    assert not found if has_secret else len(found) > 25, sorted(found)


def keys() -> dict[str, list[str]]:
    """Returns the keys of all paired devices, by the file in which bluetoothd keeps them."""
    infos = {str(file): file.read_text().splitlines() for file in Path("/var/lib/bluetooth").glob("*/*/info")}
    keys = {file: [line for line in lines if line.startswith("Key=")] for file, lines in infos.items()}
    return {file: lines for file, lines in keys.items() if lines}


@pytest.mark.few
@pytest.mark.parametrize("bytes_per_s", [100_000, 0])
def test_delivers_a_megabyte_intact(robots, bytes_per_s):
    one, two = pair(robots)
    limit_rate(bytes_per_s)
    try:
        with one.session() as here, two.session() as there:
            collector = Collector(there, "rect/bulk", here)
            here.put("rect/bulk", MEGABYTE, congestion_control=zenoh.CongestionControl.BLOCK)
            [received] = collector.take(1)
            assert hashlib.sha256(received).digest() == hashlib.sha256(MEGABYTE).digest()
    finally:
        limit_rate(0)


@pytest.mark.few
@pytest.mark.parametrize("bytes_per_s", [100_000, 0])
def test_frozen_receiver_loses_no_messages(robots, bytes_per_s):
    one, two = pair(robots)
    limit_rate(bytes_per_s)
    messages = [b"%d " % n + bytes(900) for n in range(500)]
    try:
        with one.session() as here, two.session() as there:
            collector = Collector(there, "rect/frozen", here)
            for message in messages:
                here.put("rect/frozen", message, congestion_control=zenoh.CongestionControl.BLOCK)
                if message is messages[50]:
                    two.freeze()
            # This pause is part of the scenario (shorter than Zenoh's lease), and not a wait for a condition.
            time.sleep(5)
            two.thaw()
            assert collector.take(len(messages)) == messages
    finally:
        two.thaw()
        limit_rate(0)
    assert (one.log() + two.log()).count("linked with") == 2, "the link was never replaced"


def limit_rate(bytes_per_s: int) -> None:
    """Limits the rate of both radios; 0: as fast as the emulation."""
    for adapter in ("hci0", "hci1"):
        guest("room", "pace", adapter, str(bytes_per_s))


@pytest.mark.parametrize(("side", "away_s"), [("listener", 0.3), ("listener", 10), ("dialler", 0.3), ("dialler", 10)])
def test_reconnects_after_peer_restart(robots, side, away_s):
    listener, dialler = pair(robots)
    stopped, other = (listener, dialler) if side == "listener" else (dialler, listener)
    with other.session() as there:
        stopped.kill()
        wait_until("the end is detected", 30, lambda: not other.ble_links())
        # This pause is part of the scenario, and not a wait for a condition.
        time.sleep(away_s)
        restarted = time.monotonic()
        stopped.start()
        up_s = time.monotonic() - restarted
        with stopped.session() as here:
            Collector(there, "rect/again", here).close()
            message_s = time.monotonic() - restarted
            print(f"the {side} is up {up_s:.2f} s after its restart; its first message arrived after {message_s:.2f} s")


def test_reconnects_after_supervision_timeout(robots):
    one, two = pair(robots)
    with one.session() as here, two.session() as there:
        collector = Collector(there, "rect/again", here)
        for _ in range(3):
            links = one.log().count("linked with")
            guest("room", "drop", "hci0")
            took = wait_until("the two are linked again", 30, lambda n=links: one.log().count("linked with") > n)
            reached = collector.wait_until_reached(here)
            print(f"linked again {took:.2f} s after the loss, first message {reached:.2f} s later")


def test_reconnects_after_adapter_power_cycle(robots):
    one, two = pair(robots)
    with one.session() as here, two.session() as there:
        collector = Collector(there, "rect/again", here)
        power("hci0", "off")
        wait_until("the end is detected", 30, lambda: not one.ble_links() and not two.ble_links())
        power("hci0", "on")
        print(f"first message {collector.wait_until_reached(here):.2f} s after the adapter was on")


def test_scan_lists_listening_robots(robots):
    (one,) = robots(1)
    one.start([], ble_options=";fleet=lions")
    command = [os.environ["RECT_ROUTER"], "scan", "--adapter", "hci1", "--seconds", "5", "--fleet", "lions", "--json"]
    scan = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert scan.returncode == 0, scan.stderr
    (robot,) = json.loads(scan.stdout)
    assert robot["address"] == guest("adapter", "address", "hci0")
    assert (robot["name"], robot["fleet"]) == (one.name, "lions")


def test_reconnects_after_adapters_are_renumbered(robots):
    one, two = pair(robots)
    addresses = [guest("adapter", "address", f"hci{n}") for n in range(2)]
    with one.session() as here, two.session() as there:
        collector = Collector(there, "rect/again", here)
        for name, address in zip(guest("room", "swap", "hci0", "hci1").split(), addresses, strict=True):
            guest("adapter", "wait", name)
            assert guest("adapter", "address", name) == address
        print(f"first message {collector.wait_until_reached(here):.2f} s after both adapters were on")


def test_reconnects_after_suspend(robots):
    one, two = pair(robots)
    with one.session() as here, two.session() as there:
        collector = Collector(there, "rect/again", here)
        # The kernel suspends Bluetooth, freezes all processes for 5 s, and resumes everything.
        Path("/sys/power/pm_test").write_text("freezer")
        Path("/sys/power/state").write_text("freeze")
        print(f"first message {collector.wait_until_reached(here):.2f} s after the sleep")


def test_clock_change_does_not_affect_the_link(robots):
    one, two = pair(robots)
    with one.session() as here, two.session() as there:
        collector = Collector(there, "rect/again", here)
        now = time.time()
        try:
            for years in (10, -1):
                time.clock_settime(time.CLOCK_REALTIME, now + years * 365 * 86400)
                collector.wait_until_reached(here)
        finally:
            time.clock_settime(time.CLOCK_REALTIME, now)
        assert one.log().count("linked with") == 1, "still the first link"


def test_router_with_permission_sets_the_connection_timing(robots):
    folder = Path("/sys/kernel/debug/bluetooth/hci0")
    defaults = {"conn_min_interval": 24, "conn_max_interval": 40, "supervision_timeout": 42}
    # The defaults of Linux. The maximum interval comes first, because it must not be below the minimum.
    for name in sorted(defaults):
        (folder / name).write_text(str(defaults[name]))
    pair(robots)
    assert [int((folder / name).read_text()) for name in defaults] == [6, 20, 200]


def test_link_survives_bluetoothd_restart_and_reconnects(robots):
    one, two = pair(robots)
    with one.session() as here, two.session() as there:
        collector = Collector(there, "rect/again", here)
        guest("bluetoothd", "kill")
        start_bluetoothd()
        collector.wait_until_reached(here)
        two.kill()
        wait_until("the end is detected", 30, lambda: not one.ble_links())
        two.start()
        wait_until("the two are linked again", 60, lambda: linked(one, two))


def test_listens_and_dials_after_bluetoothd_restart(robots):
    one, two = robots(2)
    one.start([])
    two.start(["ble/nobody"])
    guest("bluetoothd", "kill")
    start_bluetoothd()
    wait_until("the listener is back", 30, lambda: one.log().count("listens on hci0") == 2)
    two.kill()
    two.start([f"ble/{one.name}"])
    wait_until("the two are linked", 60, lambda: linked(one, two))


@pytest.mark.few
def test_two_robots_that_dial_each_other_make_one_link(robots):
    one, two = robots(2)
    for _ in range(5):
        one.start([f"ble/{two.name}"], wait=False)
        two.start([f"ble/{one.name}"])
        one.wait_until_up()
        wait_until("the two are linked", 30, lambda: linked(one, two))
        with one.session() as here, two.session() as there:
            Collector(there, "rect/once", here).close()
            Collector(here, "rect/back", there).close()
        assert linked(one, two), "still one link"
        one.kill()
        two.kill()


def test_router_keeps_running_without_the_dialled_peer(robots):
    (one,) = robots(1)
    one.start(["ble/nobody"])
    with one.session() as here, one.session() as there:
        Collector(there, "rect/local", here).close()


def test_router_reports_a_missing_or_disabled_adapter(robots, tmp_path):
    missing = Robot("wombat-9", "hci9", tmp_path / "missing.log")
    ends_by_itself(missing)
    assert "there is no bluetooth adapter hci9: available adapters: hci0, hci1" in missing.log()
    power("hci1", "off")
    off = Robot("wombat-8", "hci1", tmp_path / "off.log")
    ends_by_itself(off)
    power("hci1", "on")
    assert "hci1 is switched off: run `bluetoothctl power on`" in off.log()


def test_second_router_with_the_same_name_reports_the_conflict(robots, tmp_path):
    (one,) = robots(1)
    one.start([])
    duplicate = Robot(one.name, "hci1", tmp_path / "duplicate.log")
    try:
        duplicate.start([], wait=False)
        # It ends, unless it is busy and discovers the other one after it has begun to listen.
        wait_until("it reports the conflict", 60, lambda: "give one of the two another name=" in duplicate.log())
        assert one.ble_links() == []
    finally:
        duplicate.kill()


def ends_by_itself(robot: Robot) -> None:
    """Starts a router that cannot work, and waits for its end: one that stays would disturb the next scenarios."""
    try:
        robot.start([], wait=False)
        wait_until(f"the router of {robot.name} ends", 60, robot.ended)
    finally:
        robot.kill()


def test_router_reports_missing_bluetoothd(robots):
    (one,) = robots(1)
    guest("bluetoothd", "stop")
    try:
        with pytest.raises(RobotError):
            one.start([])
        assert "bluetoothd does not answer" in one.log() and "systemctl start bluetooth" in one.log()
    finally:
        start_bluetoothd()


DENY_BLUEZ_POLICY = """<busconfig><policy user="nobody"><deny send_destination="org.bluez"/></policy></busconfig>"""


def test_router_advises_a_user_without_permission():
    policy = Path("/etc/dbus-1/system.d/forbidden.conf")
    policy.write_text(DENY_BLUEZ_POLICY)
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
        # A copy in a folder that this user can read.
        router = shutil.copy(os.environ["RECT_ROUTER"], "/tmp/router-of-nobody")
        command = ["setpriv", "--reuid=nobody", "--regid=nogroup", "--clear-groups", router, "-l", "ble/hci0#name=x"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    finally:
        policy.unlink()
        guest(*reload)
    assert done.returncode == 1, done.stderr
    assert "sudo usermod -aG bluetooth" in done.stderr
