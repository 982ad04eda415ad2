"""Formats the result of a bench as a table, in plain text and in Markdown."""

import datetime
import os
import platform
from dataclasses import dataclass, field

from comparison import IS_STEADY, STEADY_PROCESSOR


@dataclass
class Table:
    """A table with notes for the reader."""

    title: str
    columns: list[str]
    rows: list[list[str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add(self, *cells: object) -> None:
        self.rows.append([str(cell) for cell in cells])

    def text(self) -> str:
        lines = [self.columns, *self.rows]
        widths = [max(len(line[n]) for line in lines) for n in range(len(self.columns))]
        padded = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines]
        return "\n".join(["", self.title, *(f"  {line.rstrip()}" for line in padded), *self.notes, ""])

    def markdown(self, command: str) -> str:
        def row(cells: list[str]) -> str:
            return f"| {' | '.join(cells)} |"

        made = f"Made by `{command}` on {datetime.date.today()}: {machine()}."
        lines = [f"# {self.title}", "", row(self.columns), row(["---"] * len(self.columns)), *map(row, self.rows), ""]
        return "\n".join([*lines, *(f"{note}\n" for note in self.notes), made, ""])


def machine() -> str:
    if IS_STEADY:
        kernel = platform.release().split("-")[0]
        return f"{STEADY_PROCESSOR}, Linux {kernel}"
    with open("/proc/cpuinfo") as info:
        model = next((line.split(":", 1)[1].strip() for line in info if line.startswith("model name")), "unknown CPU")
    return f"{os.cpu_count()} cores of {model}, Linux {platform.release().split('-')[0]}"
