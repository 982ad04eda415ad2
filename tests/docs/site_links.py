"""Finds links of a built site that lead nowhere: files and anchors that do not exist."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

#: Folders that `make docs` adds with the tools of each language.
_ADDED = ("api/",)


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        for name, value in attributes:
            if name in ("id", "name") and value:
                self.anchors.add(value)
            elif value is not None and name in ("href", "src") and tag in ("a", "img", "link", "script", "source"):
                self.links.append(value)


def broken_links(site: Path) -> list[str]:
    """Returns the links to missing files or anchors, as `page: link`."""
    pages = {path: _parse(path) for path in site.rglob("*.html") if path.name != "404.html"}
    broken = []
    for path, page in pages.items():
        for link in page.links:
            url = urlsplit(link)
            if url.scheme or url.netloc:
                continue
            target = (path.parent / unquote(url.path)).resolve() if url.path else path
            if target.is_dir():
                target /= "index.html"
            if target.relative_to(site.resolve()).as_posix().startswith(_ADDED):
                continue
            has_anchor = not url.fragment or target not in pages or unquote(url.fragment) in pages[target].anchors
            if not target.exists() or not has_anchor:
                broken.append(f"{path.relative_to(site)}: {link}")
    return broken


def _parse(path: Path) -> _Page:
    page = _Page()
    page.feed(path.read_text())
    return page
