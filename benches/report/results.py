"""Reads the tables of `benches/results/`."""

import re
from dataclasses import dataclass
from pathlib import Path

RESULTS = Path(__file__).resolve().parent.parent / "results"


@dataclass
class Results:
    """The table of a bench."""

    name: str
    title: str
    #: Each row by the names of its columns. A repeated name has a number, as in `p99 2`.
    rows: list[dict[str, str]]
    #: When it was measured, such as 2026-11-23.
    date: str


def read(name: str) -> Results:
    """Reads results/NAME.md. Fails with ValueError if it is not such a table."""
    text = (RESULTS / f"{name}.md").read_text()
    lines = text.splitlines()
    table = [cells(line) for line in lines if line.startswith("|")]
    date = re.search(r"^Made by .* on (\d{4}-\d\d-\d\d)", text, re.MULTILINE)
    if len(table) < 3 or date is None or not lines[0].startswith("# "):
        raise ValueError(f"{name}.md contains no table with a date")
    columns = numbered(table[0])
    rows = [dict(zip(columns, row, strict=True)) for row in table[2:]]
    return Results(name, lines[0][2:], rows, date[1])


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split(" | ")]


def numbered(names: list[str]) -> list[str]:
    return [
        name if names[:at].count(name) == 0 else f"{name} {names[:at].count(name) + 1}" for at, name in enumerate(names)
    ]


def number(text: str) -> float:
    """Returns the first number of a cell, such as 1240.5 of `1,240.5 ms (0.97)`; NaN if there is none."""
    found = re.search(r"-?\d[\d,]*\.?\d*", text)
    return float(found[0].replace(",", "")) if found else float("nan")


def share(text: str) -> float:
    """Returns the quotient of a cell such as `124/240`."""
    part, whole = text.split("/")
    return float(part) / float(whole)
