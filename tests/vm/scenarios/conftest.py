"""Inside the VM: robots on the emulated controllers, each with a router, with stock eclipse-zenoh clients."""

import subprocess
import sys
from pathlib import Path

import pytest
import zenoh

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "examples" / "demo"))

from robots import Inbox, Robot, wait_until


def guest(*command: str) -> str:
    """Runs one of `tests/vm/guest`'s helpers."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, f"{' '.join(command)}: {done.stderr}"
    return done.stdout.strip()


def start_bluetoothd() -> None:
    """Returns when both adapters are up."""
    guest("bluetoothd", "start")
    for adapter in ("hci0", "hci1"):
        guest("adapter", "wait", adapter)


def power(adapter: str, state: str) -> None:
    """Switches an adapter, with a supervisor as systemd is on a robot: BlueZ 5.66 was seen to crash at that."""

    def switched() -> bool:
        guest("bluetoothd", "start")
        return subprocess.run(["adapter", "power", adapter, state], capture_output=True, timeout=60).returncode == 0

    wait_until(f"{adapter} is {state}", 90, switched)


def exchange(here: zenoh.Session, there: zenoh.Session) -> None:
    """Fifty messages each way, all of them in order."""
    for sender, receiver in ((here, there), (there, here)):
        inbox = Inbox(receiver, "rect/both/ways", sender)
        for n in range(50):
            sender.put("rect/both/ways", f"message {n}")
        assert inbox.take(50) == [f"message {n}".encode() for n in range(50)]
        inbox.close()


@pytest.fixture(autouse=True)
def fresh_bluetooth():
    """Each scenario begins with a kernel and a bluetoothd that remember nothing: routers killed in the middle of a scan
    were seen to leave either at "operation in progress", which is a finding of its own."""
    guest("bluetoothd", "stop")
    adapters = guest("adapter", "list").split()
    for adapter in adapters:
        guest("hciconfig", adapter, "down")
    guest("bluetoothd", "start")
    for adapter in adapters:
        power(adapter, "on")


@pytest.fixture
def robots(tmp_path: Path):
    """Makes robots `wombat-1` on hci0, `wombat-2` on hci1, ...; ends them all."""
    made: list[Robot] = []

    def make(count: int) -> list[Robot]:
        for n in range(count):
            made.append(Robot(f"wombat-{n + 1}", f"hci{n}", tmp_path / f"wombat-{n + 1}.log"))
        return made

    yield make
    for robot in made:
        robot.kill()


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item):
    """With a failure, what the routers said last."""
    report = (yield).get_result()
    if report.failed and "tmp_path" in getattr(item, "funcargs", {}):
        for log in sorted(item.funcargs["tmp_path"].glob("*.log")):
            report.sections.append((log.name, "\n".join(log.read_text().splitlines()[-15:])))
