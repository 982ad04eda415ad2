"""Draws docs/pictures/urgent.svg, the small figure of the front page, from the table results/urgent.md: how many urgent
messages arrived, and after what time, while 1 MB is transferred over a link of 34 kB/s.

With --check, nothing is written: fails if the figure is out of date.

python benches/urgent_picture.py
"""

from __future__ import annotations

import argparse
import re
import sys
from dataclasses import dataclass
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TABLE = ROOT / "benches" / "results" / "urgent.md"
PICTURE = ROOT / "docs" / "pictures" / "urgent.svg"
LINK = "34 kB/s"
CASE = "1 MB"
#: The peers of the bench, with the names and explanations that the figure gives them.
PEERS = {
    "lanes": ("RECT", "Bluetooth link with lanes"),
    "plain link": ("Without lanes", "the same link, one queue"),
    "stock over TCP": ("Stock Zenoh", "TCP slowed down to the same rate"),
}
WIDTH, MARGIN, BAR_HEIGHT = 640, 24, 22
TOP, PITCH = 64, 84
FONTS = "Roboto, 'Segoe UI', Arial, sans-serif"
STYLE = """
    svg { --paper: #ffffff; --ink: #1f2933; --soft: #5b6b7b; --track: #e6ecf2; --good: #1565c0; --bad: #d1432b; }
    @media (prefers-color-scheme: dark) {
      svg { --paper: #16191d; --ink: #e7ecf1; --soft: #a3b1bf; --track: #2b3743; --good: #6fb1ff; --bad: #ff7a5f; }
    }
    .paper { fill: var(--paper); } text { fill: var(--ink); font-size: 15px; } .end { text-anchor: end; }
    .small { font-size: 13px; font-weight: 400; fill: var(--soft); } .head { font-weight: 600; font-size: 16px; }
    .name { font-weight: 600; } .track { fill: var(--track); } .good { fill: var(--good); } .bad { fill: var(--bad); }
    text.good, text.bad { font-weight: 600; }
"""


@dataclass(frozen=True)
class Row:
    """The result of one peer."""

    peer: str
    arrived: int
    sent: int
    p99: str
    outcome: str

    @property
    def is_good(self) -> bool:
        return self.arrived == self.sent

    @property
    def share(self) -> float:
        return self.arrived / self.sent

    def remark(self) -> str:
        """Returns the time, or the losses."""
        if self.is_good:
            return f"99 of 100 within {self.p99}"
        lost = {"bulk lost": f"the {CASE}", "link lost": "the link"}
        others = " and ".join(what for word, what in lost.items() if word in self.outcome)
        return f"{self.sent - self.arrived} were lost" + (f", and {others}" if others else "")


def rows(text: str) -> list[Row]:
    """Returns the results of the case that the figure shows.

    Raises ValueError if the table does not have them.
    """
    found = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split(" | ")]
        if len(cells) < 9 or not cells[0].startswith(f"{LINK} ") or cells[1] != CASE:
            continue
        peer, arrived, p99, outcome = cells[2], cells[4], cells[6], cells[8]
        count, _, sent = arrived.partition("/")
        found[peer] = Row(peer, int(count), int(sent), p99, outcome)
    missing = [peer for peer in PEERS if peer not in found]
    if missing:
        raise ValueError(f"{TABLE} has no row `{LINK}`, `{CASE}` of {', '.join(missing)}")
    return [found[peer] for peer in PEERS]


def bar(row: Row, top: int) -> list[str]:
    name, explanation = PEERS[row.peer]
    colour = "good" if row.is_good else "bad"
    right, width = WIDTH - MARGIN, WIDTH - 2 * MARGIN
    place = f'x="{MARGIN}" y="{top + 24}" height="{BAR_HEIGHT}" rx="4"'
    return [
        f'<text x="{MARGIN}" y="{top + 16}"><tspan class="name">{escape(name)}</tspan>'
        f'<tspan class="small" dx="10">{escape(explanation)}</tspan></text>',
        f'<text class="{colour} end" x="{right}" y="{top + 16}">{row.arrived} of {row.sent} arrived</text>',
        f'<rect class="track" {place} width="{width}"/>',
        f'<rect class="{colour}" {place} width="{width * row.share:.1f}"/>',
        f'<text class="small end" x="{right}" y="{top + 64}">{escape(row.remark())}</text>',
    ]


def picture(text: str) -> str:
    """Returns the figure for the text of the table."""
    results = rows(text)
    date = re.search(r"^Made by .* on (\d{4}-\d\d-\d\d)", text, re.MULTILINE)
    height = TOP + PITCH * len(results) + 32
    title = f"Urgent messages during a transfer of {CASE} over a link of {LINK}"
    parts = (f"{PEERS[row.peer][0]}: {row.arrived} of {row.sent} arrived, {row.remark()}." for row in results)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" viewBox="0 0 {WIDTH} {height}" '
        f'role="img" aria-labelledby="title description" font-family="{FONTS}">',
        f'  <title id="title">{escape(title)}</title>',
        f'  <desc id="description">{escape(" ".join(parts))}</desc>',
        f"  <style>{STYLE}  </style>",
        f'  <rect class="paper" width="{WIDTH}" height="{height}" rx="10"/>',
        f'  <text class="head" x="{MARGIN}" y="38">{escape(title)}</text>',
    ]
    for at, row in enumerate(results):
        lines += [f"  {line}" for line in bar(row, TOP + PITCH * at)]
    measured = f" ({date[1]})" if date else ""
    source = f"16 bytes every 50 ms, from the program that sends the {CASE}; measured by make bench{measured}"
    lines += [f'  <text class="small" x="{MARGIN}" y="{height - 20}">{escape(source)}</text>', "</svg>"]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="only check that the figure is up to date")
    options = parser.parse_args()
    drawn = picture(TABLE.read_text())
    if not options.check:
        PICTURE.write_text(drawn)
        return 0
    if PICTURE.exists() and PICTURE.read_text() == drawn:
        return 0
    print(f"{PICTURE.relative_to(ROOT)} is out of date: run benches/urgent_picture.py", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
