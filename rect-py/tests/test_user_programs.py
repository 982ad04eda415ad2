"""Programs of users, as type checkers see them: right ones pass, and wrong ones fail at the line that is wrong."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

PROGRAMS = sorted((Path(__file__).parent / "user_programs").glob("*.py"))
HERE = Path(__file__).parent.parent


def wrong_lines(program: Path) -> set[int]:
    """Returns the numbers of the lines that say that they are wrong."""
    lines = enumerate(program.read_text().splitlines(), 1)
    return {number for number, line in lines if line.endswith("# wrong")}


def mypy() -> dict[Path, set[int]]:
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--strict",
        "--no-incremental",
        "--hide-error-context",
        *map(str, PROGRAMS),
    ]
    done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=False)
    found: dict[Path, set[int]] = {}
    for line in done.stdout.splitlines():
        if match := re.match(r"(.+?):(\d+): error:", line):
            found.setdefault((HERE / match[1]).resolve(), set()).add(int(match[2]))
    return found


def pyright() -> dict[Path, set[int]]:
    command = [sys.executable, "-m", "pyright", "--outputjson", "-p", str(PROGRAMS[0].parent)]
    done = subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=False)
    found: dict[Path, set[int]] = {}
    for report in json.loads(done.stdout)["generalDiagnostics"]:
        if report["severity"] == "error":
            line = report["range"]["start"]["line"] + 1
            found.setdefault(Path(report["file"]).resolve(), set()).add(line)
    return found


@pytest.mark.parametrize("check", [mypy, pyright])
def test_wrong_lines_are_found_and_no_others(check: Callable[[], dict[Path, set[int]]]) -> None:
    found = check()
    assert len(PROGRAMS) == 2
    for program in PROGRAMS:
        assert found.get(program.resolve(), set()) == wrong_lines(program), program.name
    assert wrong_lines(PROGRAMS[1]), "the program has wrong lines"
