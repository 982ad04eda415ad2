"""What a compiler says of a value that can't be published: the advice, and which values need nothing more."""

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


def compiled(use: str) -> subprocess.CompletedProcess[str]:
    command = ["g++", "-std=c++17", "-fsyntax-only", "-Wall", "-Wextra", "-Werror", f"-I{_INCLUDE}", "-x", "c++", "-"]
    return subprocess.run(command, input=_PROGRAM.format(use=use), capture_output=True, text=True, check=False)


@pytest.mark.parametrize("value", ["12.5", "12.5f", "42", "true", "std::size_t{7}", '"text"'])
def test_numbers_and_truth_values_need_no_other_header(value: str) -> None:
    done = compiled(f'(void)robot.publish("x", {value});')
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "use",
    [
        '(void)robot.publish("x", Reading{12.5});',
        '(void)robot.publish("x", std::vector<double>{1, 2});',
        '(void)robot.send("wombat-2", "x", Reading{12.5});',
        '(void)robot.request("wombat-2", "x", Reading{12.5}, std::chrono::seconds(1));',
        '(void)rect::must(robot.listen("wombat-2", "x", std::chrono::seconds(1)))->payload.value<Reading>();',
    ],
)
def test_a_type_without_an_adapter_is_refused_with_the_header_to_include(use: str) -> None:
    done = compiled(use)
    assert done.returncode != 0
    errors = [line for line in done.stderr.splitlines() if "error:" in line]
    assert len(errors) == 1 and "include <rect/nlohmann.hpp>" in errors[0], done.stderr
