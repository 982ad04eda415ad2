"""Completes the annotations of the package, so that `typing.get_type_hints` can evaluate them.

Modules name types that they cannot import: `Session`, because modules would import each other in a circle, and numpy,
which is optional. Python 3.9 cannot evaluate `int | None`.
"""

from __future__ import annotations

import ast
import importlib
import sys
import types
from typing import Any


class _Lazy:
    """A module that is imported when an annotation names it. Without it, these objects stand for its types."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        whole = f"{self._name}.{name}"
        try:
            return importlib.import_module(whole)
        except ImportError:
            pass
        try:
            return getattr(importlib.import_module(self._name), name)
        except (ImportError, AttributeError):
            return _Lazy(whole)

    def __getitem__(self, parameters: Any) -> Any:
        return self

    def __or__(self, other: Any) -> Any:
        return self

    __ror__ = __or__

    def __call__(self) -> None:
        """Only here because the typing module expects types to be callable."""

    def __repr__(self) -> str:
        return self._name


class _Unions(ast.NodeTransformer):
    """Replaces `X | Y` by `typing.Union[X, Y]`."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if not isinstance(node.op, ast.BitOr):
            return node
        both = ast.Tuple([node.left, node.right], ast.Load())
        return ast.Subscript(ast.Attribute(ast.Name("typing", ast.Load()), "Union", ast.Load()), both, ast.Load())


def complete(names: dict[str, Any]) -> None:
    """Lets the annotations of all modules of the package that are imported name these objects, and numpy and Pillow."""
    known = {**names, "aio": _Lazy("rect.aio"), "numpy": _Lazy("numpy"), "PIL": _Lazy("PIL")}
    for name, module in list(sys.modules.items()):
        if name.startswith("rect.") and name != "rect._rect":
            space = vars(module)
            for each, value in known.items():
                space.setdefault(each, value)
            if sys.version_info < (3, 10):
                space.setdefault("typing", sys.modules["typing"])
                _replace_unions(module)


def _replace_unions(module: types.ModuleType) -> None:
    for value in list(vars(module).values()):
        if getattr(value, "__module__", None) != module.__name__:
            continue
        for member in [value, *(vars(value).values() if isinstance(value, type) else ())]:
            whole = getattr(member, "fget", None) or getattr(member, "__func__", member)
            hints: dict[str, Any] = {}
            if isinstance(whole, type):
                hints = vars(whole).get("__annotations__", {})
            elif isinstance(whole, types.FunctionType):
                hints = whole.__annotations__
            for name, hint in hints.items():
                if isinstance(hint, str) and "|" in hint:
                    hints[name] = ast.unparse(_Unions().visit(ast.parse(hint, mode="eval")))
