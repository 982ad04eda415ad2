"""Tests the documentation: each block is run, is part of a tested file, or states why not; no page tells anyone to
install a name that belongs to another project; the site builds, and its links lead somewhere.

RECT_ROUTER=target/checked/rect-router RECT_TOOL=target/checked/rect .venv/bin/python -m pytest tests/docs
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from pages import REPOSITORY, Block, Page, pages
from site_links import broken_links

_PAGES = pages()
_BLOCKS = [block for page in _PAGES if page.tested_by is None for block in page.blocks]


def _verb(block: Block) -> str | None:
    return block.directive.verb if block.directive else None


def _is_run(page: Page) -> bool:
    return any(_verb(block) == "run" for block in page.blocks)


@pytest.mark.parametrize("block", _BLOCKS, ids=str)
def test_block_is_tested_or_states_why_not(block: Block) -> None:
    verb, rest = (block.directive.verb, block.directive.rest) if block.directive else (None, "")
    for path in block.included:
        assert path.is_file(), f"{path} is missing"
    if verb == "part of":
        code = (line.strip() for line in (REPOSITORY / rest).read_text().splitlines())
        for line in filter(None, map(str.strip, block.text.splitlines())):
            assert line in code, f"{rest} does not contain, in this order: {line}"
    elif verb == "tested by":
        assert block.page.name in (REPOSITORY / rest).read_text(), f"{rest} does not name the page"
    elif verb == "not run":
        assert len(rest.split()) > 2, "a reason is missing"
    elif verb is None:
        is_whole_file = bool(block.included) and block.code.count("\n") > block.text.count("\n")
        is_used = block.title is not None and _is_used(block)
        assert block.language == "text" or is_whole_file or is_used, "a comment must state how this block is tested"


def _is_used(block: Block) -> bool:
    """Returns whether a later command of the page uses the file that the block writes."""
    page = next(page for page in _PAGES if page.path == block.page)
    later = (other for other in page.blocks if other.line > block.line)
    assert block.title is not None
    return any(_verb(other) == "run" and block.title in other.text for other in later)


@pytest.mark.parametrize("page", [page for page in _PAGES if page.tested_by], ids=str)
def test_page_is_read_by_its_test(page: Page) -> None:
    assert page.tested_by is not None
    assert page.path.stem in (REPOSITORY / page.tested_by).read_text()


@pytest.fixture(scope="session")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Makes the programs, the Python package and the C++ library available, as an installation does."""
    programs = tmp_path_factory.mktemp("bin")
    for variable, name in (("RECT_ROUTER", "rect-router"), ("RECT_TOOL", "rect")):
        path = Path(os.environ[variable]).resolve()
        assert path.exists(), f"{variable}: {path} is missing; scripts/build-for-tests builds it"
        (programs / name).symlink_to(path)
    for name in ("python", "python3"):
        script = programs / name
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
        script.chmod(0o755)
    prefix = tmp_path_factory.mktemp("prefix")
    build = REPOSITORY / "rect-cpp" / "build" / "default"
    subprocess.run(["cmake", "--install", build, "--prefix", prefix], check=True, capture_output=True)
    library = next(prefix.rglob("librect.so")).parent
    return os.environ | {
        "PATH": f"{programs}:{os.environ['PATH']}",
        "PKG_CONFIG_PATH": str(library / "pkgconfig"),
        "LD_LIBRARY_PATH": str(library),
        "CMAKE_PREFIX_PATH": str(prefix),
    }


@pytest.mark.parametrize("page", [page for page in _PAGES if _is_run(page)], ids=str)
def test_commands_do_what_the_page_says(page: Page, environment: dict[str, str]) -> None:
    runner = [sys.executable, REPOSITORY / "tests" / "docs" / "run_page.py", page.path]
    done = subprocess.run(
        ["unshare", "--map-root-user", "--net", *runner], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


#: Names of ours, and of others whose packages we mean.
_INSTALLABLE = {
    "pip": {"rect-robot", "eclipse-zenoh", "numpy", "pillow"},
    "cargo": {"rect-robot", "zenoh", "tokio", "serde", "serde_json"},
    "apt": {
        "bluez",
        "cmake",
        "g++",
        "git",
        "libnng-dev",
        "mosquitto",
        "ninja-build",
        "nlohmann-json3-dev",
        "python3-venv",
        "python3-pip",
        "pkg-config",
        "curl",
        "make",
    },
}
_INSTALLATIONS = re.compile(
    r"\b(?P<tool>pip3?|cargo|apt|apt-get) (?:install|add)\b(?P<arguments>[^`\n#;&|]*)", re.MULTILINE
)
_TEXTS = sorted(
    path
    for pattern in ("*.md", "*.py", "*.rs", "*.hpp", "*.toml", "*.json5")
    for path in REPOSITORY.rglob(pattern)
    if not any(part.startswith(".") or part in {"target", "build", "dist", "tests"} for part in path.parts)
)


def test_no_page_installs_a_name_of_another_project() -> None:
    found, wrong = 0, []
    for path in _TEXTS:
        for command in _INSTALLATIONS.finditer(path.read_text()):
            found += 1
            tool = command["tool"].rstrip("3").removesuffix("-get")
            names = [word for word in command["arguments"].split() if not word.startswith("-")]
            # A path of a file that we build.
            names = [name.strip("'\"") for name in names if not name.startswith((".", "/", "*"))]
            allowed = _INSTALLABLE[tool]
            wrong += [
                f"{path.relative_to(REPOSITORY)}: {command[0]}" for name in names if _package(name) not in allowed
            ]
    assert found > 3
    assert not wrong, "\n".join(wrong)


def _package(name: str) -> str:
    return re.split(r"[\[=<>@]", name)[0]


@pytest.mark.parametrize("script", ["scripts/command-line", "benches/urgent_picture.py"])
def test_generated_file_is_up_to_date(script: str) -> None:
    command = [sys.executable, REPOSITORY / script, "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_site_is_complete(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", tmp_path],
        cwd=REPOSITORY,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert not broken_links(tmp_path)
    for page in set(tmp_path.rglob("*.html")) - {tmp_path / "404.html"}:
        html = page.read_text()
        assert "unpkg.com" not in html, f"{page} loads a script from another server"
        assert "```" not in html, f"{page} shows the marks of a code block that MkDocs does not recognise"
