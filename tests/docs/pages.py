"""Reads the documentation: its pages, their code blocks, and the comments that state how each block is tested.

A comment stands directly before its block:

    <!-- run -->                  the commands succeed; they run in the page's folder, one block after another
    <!-- run: background -->      the commands run until the next `<!-- stop -->` or the end of the page
    <!-- stop -->                 ends the background commands, as Ctrl-C does (needs no block)
    <!-- stop: last -->           ends only the background commands that were started last
    <!-- output -->               the last commands print these lines in this order; `...` stands for any text
    <!-- part of: FILE -->        the lines are in this file, in this order; the file is tested elsewhere
    <!-- tested by: FILE -->      the test in FILE reads this block; in the first line of a page: all its blocks
    <!-- not run: REASON -->      the block cannot be tested

A block with a title (```python title="hello.py") is written to a file of this name in the page's folder, for the
commands that follow. `--8<-- "FILE"` in a block includes a file of the repository, as in the site. Blocks of `text`
need no comment.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
_FENCE = re.compile(r"^(?P<indent> *)(?P<ticks>`{3,})(?P<info>.*)$")
_COMMENT = re.compile(r"^ *<!-- *(?P<verb>run|stop|output|part of|tested by|not run)(?:: *(?P<rest>.*?))? *-->$")
_TITLE = re.compile(r'title="([^"]+)"')
_INCLUDE = re.compile(r'^--8<-- "([^"]+)"$', re.MULTILINE)


@dataclass(frozen=True)
class Directive:
    """A comment that states how the next block is tested."""

    verb: str
    rest: str = ""


@dataclass(frozen=True)
class Block:
    """A code block."""

    page: Path
    line: int
    language: str
    title: str | None
    text: str
    directive: Directive | None

    @property
    def included(self) -> list[Path]:
        """Files that the block includes."""
        return [REPOSITORY / name for name in _INCLUDE.findall(self.text)]

    @property
    def code(self) -> str:
        """The text of the block with the files that it includes."""
        return _INCLUDE.sub(lambda found: (REPOSITORY / found[1]).read_text().rstrip("\n"), self.text)

    def __str__(self) -> str:
        return f"{self.page.relative_to(REPOSITORY)}:{self.line}"


@dataclass
class Page:
    """A page: its blocks, and the comments without a block, in order."""

    path: Path
    text: str
    tested_by: str | None = None
    steps: list[Block | Directive] = field(default_factory=list)

    @property
    def blocks(self) -> list[Block]:
        return [step for step in self.steps if isinstance(step, Block)]

    def __str__(self) -> str:
        return str(self.path.relative_to(REPOSITORY))


def pages() -> list[Page]:
    """Returns the pages of the site, and the README."""
    return [read(path) for path in (REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").rglob("*.md")))]


def read(path: Path) -> Page:
    text = path.read_text()
    page = Page(path, text)
    directive: Directive | None = None
    lines = enumerate(text.splitlines(), 1)
    for number, line in lines:
        comment, fence = _COMMENT.match(line), _FENCE.match(line)
        if comment:
            directive = Directive(comment["verb"], comment["rest"] or "")
            if directive.verb == "stop":
                page.steps.append(directive)
                directive = None
            elif number == 1 and directive.verb == "tested by":
                page.tested_by, directive = directive.rest, None
        elif fence:
            page.steps.append(_block(path, number, fence, directive, lines))
            directive = None
        elif line.strip() and directive is not None:
            raise ValueError(f"{page}:{number}: no block follows the comment `{directive.verb}`")
    return page


def _block(
    path: Path, number: int, fence: re.Match[str], directive: Directive | None, lines: Iterator[tuple[int, str]]
) -> Block:
    indent, ticks, info = fence["indent"], fence["ticks"], fence["info"].strip()
    content = []
    for _, line in lines:
        if line.strip() == ticks:
            break
        content.append(line.removeprefix(indent))
    else:
        raise ValueError(f"{path}:{number}: the block has no end")
    title = _TITLE.search(info)
    language = info.split()[0].split("{")[0] if info else ""
    return Block(path, number, language, title[1] if title else None, "\n".join(content) + "\n", directive)
