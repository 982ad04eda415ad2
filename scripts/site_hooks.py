"""Hooks of MkDocs: makes the site load nothing from another server, and gives wide tables room.

Browsers run no worker for a page that is opened from a file. For the search, Material then loads a replacement, which
this hook takes from the site itself.
"""

from __future__ import annotations

from typing import Any

from mkdocs.utils import get_relative_url

_SHIM = "https://unpkg.com/iframe-worker/shim"
_OWN = "assets/iframe-worker.js"
# Pages whose tables are wider than the space between the navigation and the table of contents.
_WIDE_PAGES = {"reference/api.md"}


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Hides what is beside the text of a wide page."""
    if page.file.src_uri in _WIDE_PAGES:
        page.meta["hide"] = ["navigation", "toc"]
    return markdown


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Replaces the address of the replacement for workers in the page."""
    return output.replace(_SHIM, get_relative_url(_OWN, page.url))
