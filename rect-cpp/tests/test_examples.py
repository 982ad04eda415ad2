"""Runs the built examples, and builds and runs the programs of docs/reference/cpp.md and docs/reference/c.md.

RECT_ROUTER=target/checked/rect-router pytest rect-cpp/tests --build rect-cpp/build/default
"""

from __future__ import annotations

import os
import queue
import re
import subprocess
import threading
from pathlib import Path
from typing import Any

import pytest

_REPOSITORY = Path(__file__).resolve().parents[2]
#: Timeout for each line of output, in seconds.
_DEADLINE = 30.0


class Example:
    """A running example whose output is read line by line."""

    def __init__(self, program: Path, *arguments: str, folder: Path) -> None:
        command = [program, *arguments]
        pipe, stdout = subprocess.PIPE, subprocess.STDOUT
        self._process = subprocess.Popen(command, cwd=folder, stdin=pipe, stdout=pipe, stderr=stdout, text=True)
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True).start()

    def until(self, expected: str) -> str:
        """Returns the first line that contains `expected`."""
        line = self._lines.get(timeout=_DEADLINE)
        while expected not in line:
            line = self._lines.get(timeout=_DEADLINE)
        return line

    def until_end(self) -> None:
        """Waits until the example has ended without an error."""
        assert self._process.wait(_DEADLINE) == 0

    def __enter__(self) -> Example:
        return self

    def __exit__(self, *_: Any) -> None:
        self._process.kill()
        self._process.wait()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line.rstrip("\n"))


@pytest.fixture
def examples(build: Path, endpoint: str) -> Path:
    return build / "examples"


@pytest.mark.parametrize("name", ["hello", "hello_c"])
def test_hello(name: str, build: Path, simulation: None, tmp_path: Path) -> None:
    with Example(build / "examples" / name, folder=tmp_path) as hello:
        assert '"volts":12.4' in hello.until("battery of wombat-2: ")
        hello.until('wombat-2 arm/angle: {"degrees":')


def test_telemetry(examples: Path, tmp_path: Path) -> None:
    with (
        Example(examples / "telemetry", "wombat-1", folder=tmp_path),
        Example(examples / "telemetry", "wombat-2", folder=tmp_path) as two,
    ):
        assert "7.2 V" in two.until("wombat-1: ")


@pytest.mark.parametrize("name", ["rescue", "rescue_c"])
def test_rescue(name: str, examples: Path, tmp_path: Path) -> None:
    with (
        Example(examples / name, "wombat-1", folder=tmp_path) as one,
        Example(examples / name, "wombat-2", "12", folder=tmp_path) as two,
    ):
        one.until("wombat-2 needs help at 1.5, 0.5")
        two.until("wombat-1: 80 percent")


@pytest.mark.parametrize("name", ["state", "state_c"])
def test_state(name: str, build: Path, own_router: None, tmp_path: Path) -> None:
    def set_mode(mode: str) -> None:
        with Example(build / "examples" / name, "wombat-1", mode, folder=tmp_path) as setting:
            setting.until_end()

    set_mode("auto")
    with Example(build / "examples" / name, "wombat-1", folder=tmp_path) as printing:
        printing.until("wombat-1: auto, for ")
        set_mode("manual")
        printing.until("wombat-1: manual, for 0 s")
        set_mode("none")
        printing.until("wombat-1: none, for 0 s")


@pytest.mark.parametrize("name", ["log", "log_c"])
def test_log(name: str, build: Path, own_router: None, tmp_path: Path) -> None:
    with Example(build / "examples" / name, "wombat-1", folder=tmp_path) as log:
        log.until_end()


@pytest.mark.parametrize("name", ["dig", "dig_c"])
def test_dig(name: str, build: Path, own_router: None, tmp_path: Path) -> None:
    # The router of the digger keeps the goal.
    with Example(build / "examples" / name, "wombat-1", folder=tmp_path) as digger:
        digger.until("ready to dig")
        with Example(build / "examples" / name, "wombat-1", "wombat-1", "4", folder=tmp_path) as scout:
            scout.until(" cm, ")
            scout.until("a hole of 4 cm")
            scout.until_end()


def test_teleoperation(examples: Path, tmp_path: Path) -> None:
    with Example(examples / "teleoperation", "wombat-1", folder=tmp_path) as one:
        one.until("stopping: no command has arrived yet")
        with Example(examples / "teleoperation", "laptop", "wombat-1", folder=tmp_path):
            one.until("driving: ")
        one.until("stopping: ")


def test_camera(examples: Path, tmp_path: Path) -> None:
    with (
        Example(examples / "camera", "wombat-1", folder=tmp_path),
        Example(examples / "camera", "laptop", "wombat-1", folder=tmp_path) as two,
    ):
        assert "ms old" in two.until("frame 2:")


def test_transfer(examples: Path, tmp_path: Path) -> None:
    (tmp_path / "map.bin").write_bytes(os.urandom(300_000))
    with Example(examples / "transfer", "wombat-1", folder=tmp_path) as one:
        one.until("receives files")
        with Example(examples / "transfer", "wombat-2", "wombat-1", "map.bin", folder=tmp_path) as two:
            two.until("map.bin: complete")
        one.until("map.bin from wombat-2: received/wombat-2/map.bin")
    assert (tmp_path / "received/wombat-2/map.bin").read_bytes() == (tmp_path / "map.bin").read_bytes()


def test_request(examples: Path, tmp_path: Path) -> None:
    with Example(examples / "request", "wombat-1", folder=tmp_path) as one:
        one.until("serves requests")
        with Example(examples / "request", "wombat-2", "wombat-1", folder=tmp_path) as two:
            two.until('wombat-1: {"cell":1,"volt":3.6}')
            two.until("wombat-1 replied with an error: the cell must be 1 or 2")


def test_wombat(examples: Path, tmp_path: Path) -> None:
    with Example(examples / "wombat", "wombat-1", folder=tmp_path) as one:
        one.until("motors off")
        with Example(examples / "teleoperation", "laptop", "wombat-1", folder=tmp_path):
            one.until("motor 3: ")
        one.until("motors off")


@pytest.mark.parametrize(
    "name", ["hello", "telemetry", "teleoperation", "camera", "transfer", "request", "state", "log", "dig", "wombat"]
)
def test_examples_have_less_than_80_lines(name: str) -> None:
    assert len((_REPOSITORY / "examples" / name / "main.cpp").read_text().splitlines()) < 80


@pytest.mark.parametrize(
    ("page", "language", "compiler"),
    [("cpp", "cpp", ["g++", "-std=c++17"]), ("c", "c", ["gcc", "-std=c99"])],
)
def test_programs_in_the_documentation_print_the_documented_output(
    page: str,
    language: str,
    compiler: list[str],
    build: Path,
    own_router: None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("RECT_PARAMETERS", str(tmp_path / "parameters"))
    text = (_REPOSITORY / "docs" / "reference" / f"{page}.md").read_text()
    programs = [block for block in re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL) if "int main" in block]
    assert programs
    for n, program in enumerate(programs):
        source = tmp_path / f"{n}.{language}"
        source.write_text(program)
        lib = build / "lib"
        warnings = ["-Wall", "-Wextra", "-Wpedantic", "-Werror"]
        include = f"-I{_REPOSITORY / 'rect-cpp' / 'include'}"
        link = [f"-L{lib}", "-lrect", f"-Wl,-rpath,{lib}", "-lpthread"]
        subprocess.run([*compiler, *warnings, include, source, *link, "-o", tmp_path / str(n)], check=True)
        with Example(tmp_path / str(n), folder=tmp_path) as running:
            for expected in re.findall(r"(?://|/\*) prints: (.*?)(?: \*/)?$", program, re.MULTILINE):
                running.until(expected)
