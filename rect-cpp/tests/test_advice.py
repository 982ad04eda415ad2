"""Tests of what the compiler accepts and rejects: values with and without a header, and a program of a user.

pytest rect-cpp/tests/test_advice.py --build rect-cpp/build/default
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

_INCLUDE = Path(__file__).resolve().parents[1] / "include"
_PROGRAM = """
#include <rect.hpp>
#include <vector>
struct Reading {{ double degrees; }};
int main() {{
    auto robot = rect::must(rect::connect("wombat-1"));
    {use}
}}
"""


def compile_program(use: str) -> subprocess.CompletedProcess[str]:
    command = ["g++", "-std=c++17", "-fsyntax-only", "-Wall", "-Wextra", "-Werror", f"-I{_INCLUDE}", "-x", "c++", "-"]
    return subprocess.run(command, input=_PROGRAM.format(use=use), capture_output=True, text=True, check=False)


@pytest.mark.parametrize("value", ["12.5", "12.5f", "42", "true", "std::size_t{7}", '"text"'])
def test_numbers_bools_and_text_need_no_further_header(value: str) -> None:
    result = compile_program(f'(void)robot.publish("x", {value});')
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(
    "use",
    [
        '(void)robot.publish("x", Reading{12.5});',
        '(void)robot.publish("x", std::vector<double>{1, 2});',
        '(void)robot.send("wombat-2", "x", Reading{12.5});',
        '(void)robot.request("wombat-2", "x", Reading{12.5}, std::chrono::seconds(1));',
        '(void)rect::must(robot.wait_for_message("wombat-2/x", std::chrono::seconds(1))).payload.value<Reading>();',
    ],
)
def test_type_without_adapter_is_rejected_with_one_error_that_names_the_header(use: str) -> None:
    result = compile_program(use)
    assert result.returncode != 0
    errors = [line for line in result.stderr.splitlines() if "error:" in line]
    assert len(errors) == 1 and "include <rect/nlohmann.hpp>" in errors[0], result.stderr


_USER_PROGRAM = (Path(__file__).parent / "user_program.cpp").read_text().splitlines()
_WRONG = [number for number, line in enumerate(_USER_PROGRAM, 1) if line.endswith("// wrong")]


@pytest.mark.parametrize("wrong", [None, *_WRONG])
def test_wrong_lines_of_a_user_program_are_found_and_no_others(wrong: int | None, tmp_path: Path) -> None:
    program = tmp_path / "main.cpp"
    lines = enumerate(_USER_PROGRAM, 1)
    program.write_text("\n".join("" if number in _WRONG and number != wrong else line for number, line in lines) + "\n")
    command = ["g++", "-std=c++17", "-fsyntax-only", "-w", f"-I{_INCLUDE}", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if wrong is None:
        assert done.returncode == 0, done.stderr
    else:
        assert done.returncode != 0 and f"{program}:{wrong}:" in done.stderr, done.stderr
