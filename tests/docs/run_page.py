"""Runs the commands of one page in a folder. The page's test starts it in its own network:

unshare --map-root-user --net .venv/bin/python tests/docs/run_page.py docs/tutorial.md
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from pages import Block, Page, read
from session import Session


def main(name: str) -> None:
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    page = read(Path(name).resolve())
    with tempfile.TemporaryDirectory(prefix="rect-docs-") as folder:
        home = Path(folder) / "home"
        home.mkdir()
        work = Path(folder) / "work"
        work.mkdir()
        # Nothing of the user's own settings affects the commands.
        environment = {"HOME": str(home), "XDG_RUNTIME_DIR": str(home), "LANG": "C.UTF-8", "PYTHONUNBUFFERED": "1"}
        kept = ("PATH", "PKG_CONFIG_PATH", "LD_LIBRARY_PATH", "CMAKE_PREFIX_PATH")
        environment |= {key: os.environ[key] for key in kept if key in os.environ}
        run(page, work, Session(work, environment))


def run(page: Page, folder: Path, session: Session) -> None:
    try:
        for step in page.steps:
            try:
                if isinstance(step, Block):
                    _run_block(step, folder, session)
                elif step.rest == "last":
                    session.stop_last()
                else:
                    session.stop()
            except AssertionError as error:
                sys.exit(f"{step if isinstance(step, Block) else page}: {error}")
    finally:
        session.stop()


def _run_block(block: Block, folder: Path, session: Session) -> None:
    if block.title is not None:
        path = folder / block.title
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(block.code)
    verb = block.directive.verb if block.directive else None
    if verb == "run":
        assert block.directive is not None
        run = session.start if block.directive.rest == "background" else session.run
        run(block.code)
    elif verb == "output":
        session.expect(block.code)


if __name__ == "__main__":
    main(*sys.argv[1:])
