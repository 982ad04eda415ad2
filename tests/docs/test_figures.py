"""Tests that the figures in the tables of docs/performance.md are those of the results that their section links to.

.venv/bin/python -m pytest tests/docs/test_figures.py
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import pytest
from pages import REPOSITORY

_PAGE = REPOSITORY / "docs" / "performance.md"
_RESULT = re.compile(r"/blob/main/(benches/results/\w+\.md)")
_NUMBER = re.compile(r"\d[\d,]*(?:\.\d+)?")


@dataclass(frozen=True)
class _Row:
    """A row of a table, with the results that its section links to."""

    cells: tuple[str, ...]
    results: frozenset[str]

    def __str__(self) -> str:
        return " | ".join(self.cells)


def _rows() -> list[_Row]:
    rows = []
    for section in _PAGE.read_text().split("\n## "):
        results = frozenset(_RESULT.findall(section))
        for line in section.splitlines():
            if results and line.startswith("|") and not line.startswith("|---"):
                rows.append(_Row(tuple(cell.strip() for cell in line.strip("|").split("|")), results))
    return rows


def _numbers(text: str) -> list[str]:
    return [number.replace(",", "") for number in _NUMBER.findall(text)]


def _is_measured(number: str, measured: set[str]) -> bool:
    """Returns whether a number was measured; the page may round it."""
    decimals = len(number.partition(".")[2])
    return number in measured or any(f"{float(other):.{decimals}f}" == number for other in measured)


@pytest.mark.parametrize("row", _rows(), ids=str)
def test_figures_are_those_of_the_results(row: _Row) -> None:
    measured = {number for path in row.results for number in _numbers((REPOSITORY / path).read_text())}
    # The first cell names what was measured.
    wrong = [number for cell in row.cells[1:] for number in _numbers(cell) if not _is_measured(number, measured)]
    assert not wrong, f"not in {', '.join(sorted(row.results))}: {', '.join(wrong)}"


def test_page_has_tables() -> None:
    assert len(_rows()) > 50
