"""Tests that the examples end without a traceback at Ctrl-C: `scripts/test-python -k interrupted`"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import rect
from conftest import free_port

ROOT = Path(__file__).parents[2]
#: A part of a program that runs until Ctrl-C.
ENDLESS = re.compile(r"Event\(\)\.wait\(\)|2\*\*62|while True|for \w+ in robot\.(subscribe|watch|events)\(")
PAGES = [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md", ROOT / "rect-py" / "README.md"]


@pytest.mark.parametrize(
    ("example", "arguments", "shown"),
    [("request", ["wombat-1"], "serves"), ("dig", ["wombat-1"], ""), ("telemetry", ["wombat-1"], "wombat-1: ")],
)
def test_example_ends_without_traceback(example: str, arguments: list[str], shown: str) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with rect.connect("wombat-2", listen=[endpoint]):
        program = subprocess.Popen(
            [sys.executable, str(ROOT / "examples" / example / "main.py"), *arguments],
            env={**os.environ, "RECT_ENDPOINT": endpoint, "PYTHONUNBUFFERED": "1"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert program.stdout is not None
        line = program.stdout.readline()
        assert shown in line, line
        program.send_signal(signal.SIGINT)
        _, errors = program.communicate(timeout=60)
    assert (program.returncode, errors) == (0, "")


def test_every_endless_program_of_the_pages_ends_without_traceback() -> None:
    programs = [(path.name, path.read_text()) for path in sorted((ROOT / "examples").glob("*/main.py"))]
    for page in PAGES:
        blocks = re.findall(r"^ *```python[^\n]*\n(.*?)^ *```", page.read_text(), re.DOTALL | re.MULTILINE)
        programs += [(page.name, block) for block in blocks if re.search(r"^ *import rect$", block, re.MULTILINE)]
    endless = [(name, text) for name, text in programs if ENDLESS.search(text)]
    assert len(endless) > 20
    assert [name for name, text in endless if "KeyboardInterrupt" not in text] == []
