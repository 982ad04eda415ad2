"""All annotations of the public objects can be evaluated, as frameworks do with `typing.get_type_hints`.

pytest rect-py/tests/test_annotations.py
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest
import rect
import rect.aio


def annotated(module: ModuleType) -> Iterator[tuple[str, Any]]:
    for name in getattr(module, "__all__", dir(module)):
        value = getattr(module, name)
        if not getattr(value, "__module__", "").startswith("rect"):
            continue
        if not inspect.isclass(value):
            if inspect.isfunction(value):
                yield name, value
            continue
        yield name, value
        for member, found in vars(value).items():
            function = getattr(found, "fget", None) or getattr(found, "__func__", found)
            is_public = not member.startswith("_") or member == "__init__"
            if is_public and inspect.isfunction(function):
                yield f"{name}.{member}", function


@pytest.mark.parametrize("module", [rect, rect.aio])
def test_type_hints_of_public_objects(module: ModuleType) -> None:
    found = dict(annotated(module))
    assert len(found) > 100
    for name, value in found.items():
        try:
            typing.get_type_hints(value)
        except Exception as error:
            pytest.fail(f"{name}: {error!r}")
