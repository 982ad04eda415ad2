"""Tests the commands of rest.md and stock-zenoh.md that need programs which are built from a clone: the blocks with the
comment `tested by: tests/docs/test_builds.py`. A block of `text` is the expected output of the block before it.

RECT_ROUTER=target/checked/rect-router .venv/bin/python -m pytest tests/docs/test_builds.py

Requires `scripts/build-for-tests`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from shlex import quote

import pytest
from pages import REPOSITORY, Block, Directive, Page, read

OWN = "tests/docs/test_builds.py"
#: Programs that run until they are stopped.
_SERVERS = ("rect-router", "zenohd")


def as_run(page: Page) -> Page:
    """Returns the page with those blocks only, and with the directives that run them."""
    run = Page(page.path, page.text)
    for step in page.steps:
        if not isinstance(step, Block) or step.directive != Directive("tested by", OWN):
            continue
        if step.language == "text":
            directive = Directive("output")
        elif Path(step.text.split()[0]).name in _SERVERS:
            run.steps.append(Directive("stop"))
            directive = Directive("run", "background")
        elif step.text.startswith("curl -N "):
            directive = Directive("run", "background")
        else:
            directive = Directive("run")
            # A plugin is ready a moment after the program that loads it.
            attempt = f"bash -euo pipefail -c {quote(step.text)}"
            step = replace(step, text=f"for _ in {{1..20}}; do {attempt} && exit; sleep 1; done; exit 1")
        run.steps.append(replace(step, directive=directive))
    return run


@pytest.mark.parametrize("name", ["rest.md", "stock-zenoh.md"])
def test_commands_do_what_the_page_says(name: str, tmp_path: Path) -> None:
    built = Path(os.environ["RECT_ROUTER"]).resolve().parent
    cache = Path(os.environ.get("RECT_CACHE", Path.home() / ".cache" / "rect")).resolve()
    plugins = [built / f"libzenoh_plugin_{plugin}.so" for plugin in ("rest", "rect")]
    programs = [cache / folder / "bin" / "zenohd" for folder in ("stock-zenohd", "zenohd-ble")]
    for path in (*plugins, *programs):
        if not path.exists():
            pytest.skip(f"no {path}; see the beginning of this file")
    # The paths in the pages are those of a clone and of the user's cache.
    (tmp_path / "target").mkdir()
    (tmp_path / "target" / "release").symlink_to(built)
    (tmp_path / ".cache").mkdir()
    (tmp_path / ".cache" / "rect").symlink_to(cache)
    environment = {
        "HOME": str(tmp_path),
        "XDG_RUNTIME_DIR": str(tmp_path),
        "LANG": "C.UTF-8",
        "PATH": f"{built}:{programs[0].parent}:{os.environ['PATH']}",
    }
    page = REPOSITORY / "docs" / "how-to" / name
    done = subprocess.run(
        ["unshare", "--map-root-user", "--net", sys.executable, __file__, page, tmp_path],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


if __name__ == "__main__":
    from run_page import run
    from session import Session

    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    folder = Path(sys.argv[2])
    run(as_run(read(Path(sys.argv[1]))), folder, Session(folder, dict(os.environ)))
