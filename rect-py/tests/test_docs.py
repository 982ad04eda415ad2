"""Runs the Python blocks of docs/reference/python.md, one after another, and the examples.

RECT_ROUTER=target/checked/rect-router pytest rect-py/tests/test_docs.py
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import rect
from conftest import DEADLINE, free_port
from programs import Tool, program

_REPOSITORY = Path(__file__).resolve().parents[2]
_EXAMPLES = _REPOSITORY / "examples"


@pytest.fixture
def endpoint(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Starts a router and makes it the default one of programs."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    monkeypatch.setenv("RECT_ENDPOINT", endpoint)
    with subprocess.Popen([program("RECT_ROUTER", "rect-router"), "-l", endpoint, "--no-multicast-scouting"]) as router:
        try:
            yield endpoint
        finally:
            router.terminate()


def test_page_prints_documented_output(endpoint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (_REPOSITORY / "docs" / "reference" / "python.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert len(blocks) > 10
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "page.py"
    file.write_text("\n".join(blocks))
    done = subprocess.run(
        [sys.executable, str(file)], capture_output=True, text=True, timeout=DEADLINE * 2, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr, done.stderr
    assert "wombat-1 arm/angle {'degrees': 12.5}" in done.stdout
    assert "no program serves double at wombat-7; reachable robots:" in done.stdout


@pytest.fixture
def simulation(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Runs the simulated robots wombat-1 and wombat-2. Programs connect to wombat-1 by default."""
    pipe = subprocess.PIPE
    command = [program("RECT_ROUTER", "rect-router"), "sim", "--port", "0"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=pipe, stderr=pipe, text=True) as sim:
        try:
            line = Tool(sim).until("wombat-1  tcp/")
            monkeypatch.setenv("RECT_ENDPOINT", line.split()[1])
            yield
        finally:
            sim.terminate()


def test_first_program_prints_messages_of_simulated_robots(simulation: None) -> None:
    text = (_REPOSITORY / "docs" / "reference" / "python.md").read_text()
    (block,) = re.findall(r'```python title="first.py"\n(.*?)```', text, re.DOTALL)
    pipe = subprocess.PIPE
    reader = subprocess.Popen([sys.executable, "-u", "-c", block], stdout=pipe, stderr=pipe, text=True)
    with reader:
        try:
            output = Tool(reader)
            output.until("wombat-1 {'degrees': ")
            output.until("wombat-2 {'degrees': ")
        finally:
            reader.kill()


class Example:
    """A running example."""

    def __init__(self, name: str, *arguments: str, folder: Path) -> None:
        command = [sys.executable, str(_EXAMPLES / name / "main.py"), *arguments]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, cwd=folder, stdout=pipe, stderr=pipe, text=True)
        self.tool = Tool(self.process)

    def __enter__(self) -> Example:
        return self

    def __exit__(self, *_: Any) -> None:
        self.process.kill()
        self.process.wait()


def test_hello(simulation: None, tmp_path: Path) -> None:
    with Example("hello", folder=tmp_path) as hello:
        hello.tool.until("battery of wombat-2: {'volts': 12.4, 'percent': 83}")
        hello.tool.until("wombat-2 arm/angle: {'degrees': ")


def test_telemetry(endpoint: str, tmp_path: Path) -> None:
    with Example("telemetry", "wombat-1", folder=tmp_path), Example("telemetry", "wombat-2", folder=tmp_path) as two:
        assert "'battery_volt': 7.2" in two.tool.until("wombat-1: ")


def test_rescue(endpoint: str, tmp_path: Path) -> None:
    with (
        Example("rescue", "wombat-1", folder=tmp_path) as one,
        Example("rescue", "wombat-2", "12", folder=tmp_path) as two,
    ):
        one.tool.until("wombat-2 needs help at 1.5, 0.5")
        two.tool.until("wombat-1: 80.0 percent")


def test_teleoperation(endpoint: str, tmp_path: Path) -> None:
    with Example("teleoperation", "wombat-1", folder=tmp_path) as one:
        one.tool.until("stopping: ")
        with Example("teleoperation", "laptop", "wombat-1", folder=tmp_path):
            assert "'left':" in one.tool.until("laptop: ")
        one.tool.until("stopping: ")


def test_camera(endpoint: str, tmp_path: Path) -> None:
    with (
        Example("camera", "wombat-1", folder=tmp_path),
        Example("camera", "laptop", "wombat-1", folder=tmp_path) as two,
    ):
        assert "Picture(" in two.tool.until("frame 2:")


def test_transfer(endpoint: str, tmp_path: Path) -> None:
    (tmp_path / "map.bin").write_bytes(os.urandom(300_000))
    with Example("transfer", "wombat-1", folder=tmp_path) as one:
        one.tool.until("receives files")
        with Example("transfer", "wombat-2", "wombat-1", "map.bin", folder=tmp_path) as two:
            two.tool.until("map.bin: complete")
        one.tool.until("map.bin from wombat-2: received/wombat-2/map.bin")
    assert (tmp_path / "received/wombat-2/map.bin").read_bytes() == (tmp_path / "map.bin").read_bytes()


def test_request(endpoint: str, tmp_path: Path) -> None:
    with Example("request", "wombat-1", folder=tmp_path) as one:
        one.tool.until("serves requests")
        with Example("request", "wombat-2", "wombat-1", folder=tmp_path) as two:
            two.tool.until("wombat-1: {'cell': 1, 'volt': 3.6}")
            two.tool.until("wombat-1 replied with an error: the cell must be 1 or 2")


def test_state(simulation: None, tmp_path: Path) -> None:
    def set_mode(mode: str) -> None:
        with Example("state", "wombat-1", mode, folder=tmp_path) as one:
            assert one.process.wait(DEADLINE) == 0

    set_mode("auto")
    with Example("state", "wombat-1", folder=tmp_path) as two:
        two.tool.until("wombat-1: auto, for ")
        set_mode("manual")
        two.tool.until("wombat-1: manual, for 0 s")
        set_mode("none")
        two.tool.until("wombat-1: none, for 0 s")


def test_log(simulation: None, tmp_path: Path) -> None:
    with Example("log", "wombat-1", folder=tmp_path) as one:
        assert one.process.wait(DEADLINE) == 0
    with rect.connect("wombat-1") as robot:
        # Without a name, the program of an example has that of its script.
        lines = [(line.text, line.level, line.fields) for line in robot.logs("wombat-1", program="main")]
        assert lines == [("ready", "info", {}), ("the gripper is slow", "warn", {"angle": 12.5})]
        assert [alert.text for alert in robot.alerts()] == ["battery low"]
        robot.clear_alert("battery low")


@pytest.mark.parametrize(
    "name", ["hello", "telemetry", "teleoperation", "camera", "transfer", "request", "state", "log"]
)
def test_example_is_short(name: str) -> None:
    assert len((_EXAMPLES / name / "main.py").read_text().splitlines()) <= 40
