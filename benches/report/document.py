"""Prints the site's chapter on performance as a PDF, with all stored tables behind it."""

import html
import re
import subprocess
from pathlib import Path

from markdown import markdown
from playwright.sync_api import sync_playwright
from report.results import RESULTS, read
from serving import launched

ROOT = Path(__file__).resolve().parents[2]
CHAPTER = ROOT / "docs" / "performance.md"
#: The part of the chapter that a reader runs.
INSTRUCTIONS = "\n## Measure your own link"
HEAD = '<meta charset="utf-8"><title>RECT: measurements</title>'
STYLE = """
@page { size: A4; margin: 18mm 16mm 20mm; }
body { font: 10pt/1.4 "DejaVu Sans", sans-serif; color: #111; }
h1 { font-size: 20pt; } h2 { font-size: 13pt; margin-top: 8mm; } h3 { font-size: 10pt; }
h2, h3 { break-after: avoid; } figure, img, table { break-inside: avoid; }
img { display: block; max-width: 100%; margin: 3mm auto; }
table { border-collapse: collapse; margin: 3mm 0; width: 100%; font-size: 8.5pt; }
th, td { border-bottom: 0.3mm solid #bbb; padding: 0.8mm 2mm 0.8mm 0; text-align: left; vertical-align: top; }
code { font-size: 8.5pt; } a { color: inherit; } .admonition { border-left: 1mm solid #888; padding-left: 3mm; }
.appendix { break-before: page; } .appendix table { font-size: 6pt; } .appendix p { font-size: 7pt; }
"""
FOOTER = """
<div style="font-size: 7pt; width: 100%; text-align: center">
  <span class="pageNumber"></span> / <span class="totalPages"></span>
</div>
"""


def write(path: Path) -> None:
    """Writes the report to `path`."""
    page = path.with_suffix(".html")
    path.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(document())
    with sync_playwright() as playwright:
        browser = launched(playwright)
        shown = browser.new_page()
        shown.goto(page.as_uri())
        shown.pdf(
            path=path, format="A4", display_header_footer=True, header_template="<div></div>", footer_template=FOOTER
        )
        browser.close()


def document() -> str:
    chapter = CHAPTER.read_text().partition(INSTRUCTIONS)[0]
    title, _, text = chapter.partition("\n")
    head = f"# RECT: measurements\n\n{origin()}\n\n## {title.removeprefix('# ')}: what to expect\n"
    # The addresses of pages work on the site only; those of pictures are made absolute.
    text = re.sub(r"(?<!!)\[([^]]*)\]\((?!https?:)[^)]*\)", r"\1", text)
    body = to_html(head + text) + '<section class="appendix">' + to_html(appendix()) + "</section>"
    body = re.sub(r'src="(pictures/[^"]+)"', lambda found: f'src="{(CHAPTER.parent / found[1]).as_uri()}"', body)
    return f'<!doctype html><html lang="en">{HEAD}<style>{STYLE}</style>{body}'


def to_html(text: str) -> str:
    return markdown(text, extensions=["admonition", "attr_list", "md_in_html", "tables"])


def origin() -> str:
    """Returns where the figures come from: dates and version."""
    dates = sorted(read(file.stem).date for file in tables())
    command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty"]
    version = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() or "unknown"
    return (
        f"Measured from {dates[0]} to {dates[-1]}; printed from version {html.escape(version)}. `make report` prints "
        "it from stored tables, and `make report MEASURE=all` measures again. The appendix contains all tables, each "
        "with its conditions, its date and the machine."
    )


def tables() -> list[Path]:
    return sorted(RESULTS.glob("*.md"))


def appendix() -> str:
    parts = [f"### {file.stem}: {file.read_text().removeprefix('# ')}" for file in tables()]
    return "\n\n".join(["## Appendix: all tables", *parts])
