"""Draws the figures of the report, and prints it: docs/pictures/report/*.svg, target/report/rect-measurements.pdf.

usage: scripts/report [--check] [--figures]"""

import argparse
import io
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "examples" / "demo"), str(ROOT / "tests" / "dashboard")]

from matplotlib import pyplot  # noqa: E402
from report.figures import DRAWINGS  # noqa: E402

PICTURES = ROOT / "docs" / "pictures" / "report"
REPORT = ROOT / "target" / "report" / "rect-measurements.pdf"


def drawn(name: str) -> str:
    figure = DRAWINGS[name].draw()
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    pyplot.close(figure)
    return buffer.getvalue()


def main() -> int:
    parser = argparse.ArgumentParser(prog="scripts/report", description=__doc__)
    parser.add_argument("--check", action="store_true", help="only check that the figures show the stored results")
    parser.add_argument("--figures", action="store_true", help="only draw the figures")
    arguments = parser.parse_args()
    pictures = {PICTURES / f"{name}.svg": drawn(name) for name in DRAWINGS}
    if arguments.check:
        old = [path for path, picture in pictures.items() if not path.exists() or path.read_text() != picture]
        for path in old:
            print(f"{path.relative_to(ROOT)} does not show the stored results: run `make report`", file=sys.stderr)
        return 1 if old else 0
    PICTURES.mkdir(exist_ok=True)
    for path, picture in pictures.items():
        path.write_text(picture)
    if not arguments.figures:
        # Imported here: the figures need no browser.
        from report import document

        document.write(REPORT)
        print(f"report: {REPORT.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
