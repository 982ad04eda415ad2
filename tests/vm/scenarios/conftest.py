"""Fixtures for tests in the VM: robots on the emulated controllers, each with a router and eclipse-zenoh clients."""

import subprocess
import sys
from pathlib import Path

import pytest
import zenoh

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "examples" / "demo"))

from robots import Collector, Robot, wait_until


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "few: what `make test` runs, because the emulated computer is slow")


def guest(*command: str) -> str:
    """Runs one of `tests/vm/guest`'s helpers."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, f"{' '.join(command)}: {done.stderr}"
    return done.stdout.strip()


def start_bluetoothd() -> None:
    """Starts bluetoothd, and returns when both adapters are up."""
    guest("bluetoothd", "start")
    for adapter in ("hci0", "hci1"):
        guest("adapter", "wait", adapter)


def power(adapter: str, state: str) -> None:
    """Switches an adapter on or off. Restarts bluetoothd if it crashes, as systemd does; BlueZ 5.66 may crash then."""

    def switched() -> bool:
        guest("bluetoothd", "start")
        return subprocess.run(["adapter", "power", adapter, state], capture_output=True, timeout=60).returncode == 0

    wait_until(f"{adapter} is {state}", 90, switched)


def exchange(here: zenoh.Session, there: zenoh.Session) -> None:
    """Asserts that fifty messages arrive in order in each direction."""
    for sender, receiver in ((here, there), (there, here)):
        collector = Collector(receiver, "rect/both/ways", sender)
        for n in range(50):
            # A droppable message may be dropped by a busy computer.
            sender.put("rect/both/ways", f"message {n}", congestion_control=zenoh.CongestionControl.BLOCK)
        assert collector.take(50) == [f"message {n}".encode() for n in range(50)]
        collector.close()


@pytest.fixture(autouse=True)
def fresh_bluetooth():
    """Resets the kernel and bluetoothd before each scenario.

    A router that is killed during a scan can leave either of them at "operation in progress". Kernels since 6.12 keep
    the number of an adapter that was unplugged as long as a program uses it.
    """
    guest("bluetoothd", "stop")
    adapters = guest("adapter", "list").split()
    numbers = [f"hci{n}" for n in range(len(adapters))]
    for renumbered in set(adapters) - set(numbers):
        guest("room", "remove", renumbered)
        guest("room", "add")
    adapters = guest("adapter", "list").split()
    assert adapters == numbers
    for adapter in adapters:
        guest("hciconfig", adapter, "down")
    guest("bluetoothd", "start")
    for adapter in adapters:
        power(adapter, "on")


@pytest.fixture
def robots(tmp_path: Path):
    """Creates robots `wombat-1` on hci0, `wombat-2` on hci1, and so on, and stops them after the test."""
    running: list[Robot] = []

    def make(count: int) -> list[Robot]:
        for n in range(count):
            running.append(Robot(f"wombat-{n + 1}", f"hci{n}", tmp_path / f"wombat-{n + 1}.log"))
        return running

    yield make
    for robot in running:
        robot.kill()


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item):
    """Adds the last lines of the routers' logs to the report of a failed test."""
    report = (yield).get_result()
    if report.failed and "tmp_path" in getattr(item, "funcargs", {}):
        for log in sorted(item.funcargs["tmp_path"].glob("*.log")):
            report.sections.append((log.name, "\n".join(log.read_text().splitlines()[-15:])))
