"""Tests that docs/troubleshooting.md quotes the messages of the programs: texts of the sources make up most of each.

.venv/bin/python -m pytest tests/docs/test_messages.py
"""

from __future__ import annotations

import re
from functools import cache

import pytest
from pages import REPOSITORY

_PAGE = REPOSITORY / "docs" / "troubleshooting.md"
_SOURCES = ("src", "crates", "zenoh-link-ble/src", "rect-router/src", "rect-py/python")
#: A message of RECT in the page; those of other programs have single quotes.
_MESSAGE = re.compile(r"^- `` (.+) ``$", re.MULTILINE)
#: The share of a message that must be found; the rest are names, and reasons of the system.
_FOUND = 0.4
#: Texts with fewer characters outside of their placeholders prove nothing.
_SHORTEST = 10
#: The end of a message that the page does not quote to its end.
_CUT = " ..."
_LITERAL = re.compile(r'"((?:[^"\\]|\\.)*)"', re.DOTALL)
_PLACEHOLDER = re.compile(r"\{[^{}]*\}")
_CONTINUED = re.compile(r"\\\n\s*|\"\s*\n\s*f?\"")


@cache
def _texts() -> frozenset[tuple[str, ...]]:
    """Returns the texts in the sources, each as the parts between its placeholders."""
    texts = set()
    for folder in _SOURCES:
        for path in (REPOSITORY / folder).rglob("*"):
            if path.suffix in (".rs", ".py"):
                for literal in _LITERAL.findall(_CONTINUED.sub("", path.read_text())):
                    text = re.sub(r'\\(["\\])', r"\1", literal)
                    texts.add(tuple(part for part in _PLACEHOLDER.split(text) if part))
    return frozenset(text for text in texts if sum(map(len, text)) >= _SHORTEST)


def _spans(text: tuple[str, ...], message: str, is_cut: bool) -> list[tuple[int, int]]:
    """Returns where the parts of a text are in a message; nothing unless all of them are, in this order."""
    spans: list[tuple[int, int]] = []
    end = 0
    for part in text:
        start = message.find(part, end)
        if start < 0:
            lengths = range(len(part) - 1, 0 if spans else _SHORTEST, -1) if is_cut else ()
            length = next((length for length in lengths if message.endswith(part[:length])), 0)
            return [*spans, (len(message) - length, len(message))] if length else []
        end = start + len(part)
        spans.append((start, end))
    return spans


def _share(message: str) -> float:
    """Returns the share of a message that consists of texts in the sources."""
    quoted = message.removesuffix(_CUT)
    found = bytearray(len(quoted))
    for text in _texts():
        for start, end in _spans(text, quoted, quoted != message):
            found[start:end] = b"\1" * (end - start)
    return sum(found) / len(quoted)


@pytest.mark.parametrize("message", _MESSAGE.findall(_PAGE.read_text()))
def test_message_is_in_the_sources(message: str) -> None:
    assert _share(message) > _FOUND, f"{_share(message):.2f}"


@pytest.mark.parametrize(
    "message",
    [
        "no link to wombat-2: the antenna is missing; buy another one",
        "the transfer to wombat-2 ended: its disk is slow",
        "the robot wombat-1 cannot reach the moon because its battery contains too little cheese",
    ],
)
def test_invented_message_is_not_in_the_sources(message: str) -> None:
    assert _share(message) < _FOUND
