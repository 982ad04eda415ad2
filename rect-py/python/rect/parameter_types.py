"""Defines the types of parameters, which programs declare with `Robot.parameters`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Union

from rect import _rect


@dataclass(frozen=True)
class Parameter:
    """The declaration of a parameter: a `Number`, `Integer`, `Choice`, `Text`, `Bool` or `Numbers`."""

    #: The value until somebody changes it.
    default: Any
    #: Its purpose, in the program's words; empty if there are none.
    about: str = ""
    #: Whether only the program itself changes it.
    read_only: bool = False
    #: The unit, such as `m/s`; empty if there is none.
    unit: str = ""
    #: The smallest number. `None`: any.
    min: float | None = None
    #: The largest number. `None`: any.
    max: float | None = None
    #: The choices; empty unless it is a `Choice`.
    choices: Sequence[str] = ()


class Number(Parameter):
    """A finite number.

    - `min`, `max`: the smallest and the largest number. Default: any.
    - `unit`: the unit, at most 20 characters. Default: none.
    - `about`: its purpose, at most 200 characters. Default: none.
    - `read_only`: whether only the program itself changes it. Default: `False`.
    """

    def __init__(
        self,
        default: float = 0.0,
        *,
        min: float | None = None,
        max: float | None = None,
        unit: str = "",
        about: str = "",
        read_only: bool = False,
    ) -> None:
        super().__init__(default, about, read_only, unit, min, max)


class Integer(Parameter):
    """An integer, between -2^53 and 2^53; for its options see `Number`."""

    def __init__(
        self,
        default: int = 0,
        *,
        min: float | None = None,
        max: float | None = None,
        unit: str = "",
        about: str = "",
        read_only: bool = False,
    ) -> None:
        super().__init__(default, about, read_only, unit, min, max)


class Numbers(Parameter):
    """A list of at most 256 finite numbers, each of which is in the range; for its options see `Number`."""

    def __init__(
        self,
        default: Sequence[float] = (),
        *,
        min: float | None = None,
        max: float | None = None,
        unit: str = "",
        about: str = "",
        read_only: bool = False,
    ) -> None:
        super().__init__(default, about, read_only, unit, min, max)


class Text(Parameter):
    """A text of at most 4 kB; for its options see `Number`."""

    def __init__(self, default: str = "", *, about: str = "", read_only: bool = False) -> None:
        super().__init__(default, about, read_only)


class Bool(Parameter):
    """Yes or no; for its options see `Number`."""

    def __init__(self, default: bool = False, *, about: str = "", read_only: bool = False) -> None:
        super().__init__(default, about, read_only)


class Choice(Parameter):
    """One of at most 64 texts; for its options see `Number`. `default`: the first one."""

    def __init__(self, *choices: str, default: str | None = None, about: str = "", read_only: bool = False) -> None:
        if default is None:
            default = choices[0] if choices else ""
        super().__init__(default, about, read_only, choices=choices)


#: The declaration of a parameter. A value alone declares one with that default and any range.
Declared = Union[Parameter, bool, int, float, str, Sequence[float]]

_KINDS: dict[str, type[Parameter]] = {
    "number": Number,
    "integer": Integer,
    "numbers": Numbers,
    "text": Text,
    "bool": Bool,
    "choice": Choice,
}
_NAMES = {kind: name for name, kind in _KINDS.items()}


def declaration_of(parameters: Mapping[str, Declared]) -> _rect.ParameterDeclaration:
    """Checks the parameters of a group. Raises `ParameterError`."""
    return _rect.ParameterDeclaration([_parts_of(name, declared) for name, declared in parameters.items()])


def parameters_of(declaration: list[_rect._ParameterParts]) -> dict[str, Parameter]:
    """Returns the parameters of a group in the catalogue of a robot."""
    return {parts[0]: _parameter_of(*parts) for parts in declaration}


def _parts_of(name: str, declared: Declared) -> _rect._ParameterParts:
    if not isinstance(declared, Parameter):
        # The type is that of the value.
        return name, None, declared, None, None, [], "", "", False
    one = declared
    kind = _NAMES.get(type(one))
    return name, kind, one.default, one.min, one.max, one.choices, one.unit, one.about, one.read_only


def _parameter_of(
    _: str,
    kind: str | None,
    default: Any,
    min: float | None,
    max: float | None,
    choices: Sequence[str],
    unit: str,
    about: str,
    read_only: bool,
) -> Parameter:
    # Only a declaration of this program leaves it out.
    assert kind is not None
    parameter = object.__new__(_KINDS[kind])
    Parameter.__init__(parameter, default, about, read_only, unit, min, max, tuple(choices))
    return parameter
