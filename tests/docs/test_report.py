"""The figures of the report show the stored results: scripts/report."""

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_figures_show_the_stored_results() -> None:
    done = subprocess.run([ROOT / "scripts" / "report", "--check"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
