"""Converts values to the type that a program states for them: numbers, lists, dataclasses, models and so on."""

from __future__ import annotations

import collections.abc
import dataclasses
import enum
import math
import sys
import types
import typing
from collections.abc import Callable
from datetime import datetime, timezone
from typing import TYPE_CHECKING, Any, Generic, Literal, Union, cast

from rect.errors import MismatchError

if TYPE_CHECKING:
    from typing_extensions import TypeVar

    #: The type of a value, which a program need not state: `Message` is a `Message[Any]`.
    T = TypeVar("T", default=Any)
else:
    T = typing.TypeVar("T")
#: Returns a value as the type that the program has stated, or raises `Misfit`.
Convert = Callable[[Any], Any]

#: How much of a value that does not fit is shown.
_SHOWN = 60
_UNIONS = (Union, getattr(types, "UnionType", Union))
_LISTS = (list, collections.abc.Sequence, collections.abc.Iterable, collections.abc.Collection)
_DICTS = (dict, collections.abc.Mapping)


class Misfit(Exception):
    """A part of a value does not fit its type."""

    def __init__(self, expected: str, found: str) -> None:
        super().__init__(expected, found)
        self.expected = expected
        self.found = found
        #: The steps from the part to the whole value: names of fields, and indices of lists.
        self.steps: list[str | int] = []

    def within(self, step: str | int) -> Misfit:
        """Adds the step that leads to the part."""
        self.steps.append(step)
        return self

    @property
    def field(self) -> str:
        """The path to the part, such as `cells[2].volt`. Empty for the value itself."""
        steps = (f"[{step}]" if isinstance(step, int) else f".{step}" for step in reversed(self.steps))
        return "".join(steps).lstrip(".")


class Converter(Generic[T]):
    """Converts values to one type."""

    def __init__(self, type: Any) -> None:
        """Raises `TypeError` if the library cannot convert values to this type."""
        self.type = type
        self._convert = _converter(type, ())

    def convert(self, value: Any) -> T:
        """Returns the value as the type. Raises `MismatchError`."""
        try:
            return cast(T, self._convert(value))
        except Misfit as misfit:
            raise MismatchError(misfit.field, misfit.expected, misfit.found) from None

    def check(self, value: T) -> None:
        """Raises `TypeError` if a value that the program passes is of another class than the type."""
        if isinstance(self.type, type) and not isinstance(value, self.type):
            is_number = self.type is float and isinstance(value, int)
            if not is_number:
                raise TypeError(f"the value must be of the type {name_of(self.type)}, not {name_of(value.__class__)}")


def converter_of(type: Any) -> Converter[Any] | None:
    """Returns the converter to a type that a program has stated; `None` if it has stated none, or that any will do."""
    if type is None or type is Any or type is object:
        return None
    if not isinstance(type, _CLASS) and typing.get_origin(type) is None:
        text = "pass a function as callback=" if callable(type) else "for example a dataclass, or list[float]"
        raise TypeError(f"{type!r} is not a type of values: {text}")
    return Converter(type)


_CLASS = type


def name_of(of: Any) -> str:
    """Returns the name of a type, as the program writes it."""
    return str(of).replace("typing.", "") if typing.get_args(of) else getattr(of, "__name__", str(of))


def _converter(of: Any, outer: tuple[Any, ...]) -> Convert:
    """Returns the function that converts to a type. `outer` are the classes whose fields lead to it."""
    if of in _SIMPLE:
        return _SIMPLE[of]
    origin, arguments = typing.get_origin(of), typing.get_args(of)
    if origin is typing.Annotated or origin in (typing.Final, typing.ClassVar):
        return _converter(arguments[0], outer)
    if origin in _UNIONS:
        return _union([(argument, _converter(argument, outer)) for argument in arguments])
    if origin is Literal:
        return _one_of({value: value for value in arguments})
    if of in _LISTS or origin in _LISTS:
        return _list(_converter(arguments[0] if arguments else Any, outer))
    if of is tuple or origin is tuple:
        return _tuple(arguments, outer)
    if of in (set, frozenset) or origin in (set, frozenset):
        convert = _list(_converter(arguments[0] if arguments else Any, outer))
        return lambda value: (origin or of)(convert(value))
    if of in _DICTS or origin in _DICTS:
        key, item = arguments or (Any, Any)
        return _dict(_converter(key, outer), _converter(item, outer))
    if isinstance(of, type):
        return _class(of, outer)
    raise _not_possible(of, outer)


def _class(of: type, outer: tuple[Any, ...]) -> Convert:
    if of in outer:
        path = " -> ".join(name_of(one) for one in (*outer[outer.index(of) :], of))
        raise TypeError(
            f"{name_of(of)} contains itself ({path}): state a type without a cycle, or use dict in its place"
        )
    if issubclass(of, enum.Enum):
        return _one_of({member.value: member for member in of})
    if hasattr(of, "model_validate"):
        return _pydantic(of)
    if hasattr(of, "__struct_fields__"):
        return _msgspec(of)
    if dataclasses.is_dataclass(of):
        return _dataclass(of, (*outer, of))
    if typing.is_typeddict(of) if sys.version_info >= (3, 10) else hasattr(of, "__total__"):
        return _typed_dict(of, (*outer, of))
    if of.__module__.partition(".")[0] in ("numpy", "rect"):
        return _instance(of)
    raise _not_possible(of, outer)


def _not_possible(of: Any, outer: tuple[Any, ...]) -> TypeError:
    within = f" (a field of {name_of(outer[-1])})" if outer else ""
    return TypeError(
        f"values cannot be converted to {name_of(of)}{within}: use a dataclass, an Enum, list, dict, tuple, set, "
        "Optional, Union, Literal, datetime, str, int, float, bool, bytes, or a model of pydantic or msgspec"
    )


def described(value: Any) -> str:
    """Returns what a value is, in words."""
    if value is None:
        return "nothing (null)"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return "NaN" if value != value else f"the number {value!r}"
    if isinstance(value, str):
        return f"the text {shortened(value)!r}"
    if isinstance(value, (bytes, bytearray)):
        return f"{len(value)} bytes"
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}"
    if isinstance(value, dict):
        return "an object with the fields " + shortened(", ".join(map(str, value))) if value else "an empty object"
    return f"a value of the type {name_of(type(value))}"


def shortened(text: str) -> str:
    return text if len(text) <= _SHOWN else text[: _SHOWN - 1] + "…"


def _any(value: Any) -> Any:
    return value


def _bool(value: Any) -> bool:
    if value is True or value is False:
        return bool(value)
    raise Misfit("true or false", described(value))


def _int(value: Any) -> int:
    if type(value) is int:
        return value
    # JSON of other languages may write 3 as 3.0.
    if type(value) is float and value.is_integer():
        return int(value)
    raise Misfit("an integer", described(value))


def _float(value: Any) -> float:
    if type(value) is float:
        return value
    if type(value) is int:
        try:
            return float(value)
        except OverflowError:
            return math.inf if value > 0 else -math.inf
    raise Misfit("a number", described(value))


def _str(value: Any) -> str:
    if type(value) is str:
        return value
    raise Misfit("text", described(value))


def _bytes(value: Any) -> bytes:
    if type(value) is bytes:
        return value
    raise Misfit("bytes", described(value))


def _none(value: Any) -> None:
    if value is not None:
        raise Misfit("nothing (null)", described(value))


def _datetime(value: Any) -> datetime:
    if type(value) is str:
        try:
            # Before Python 3.11, `fromisoformat` does not know the Z for UTC.
            read = datetime.fromisoformat(value[:-1] + "+00:00" if value.endswith("Z") else value)
        except ValueError:
            pass
        else:
            return read if read.tzinfo else read.replace(tzinfo=timezone.utc)
    raise Misfit("a time such as 2026-11-29T12:00:00Z", described(value))


_SIMPLE: dict[Any, Convert] = {
    Any: _any,
    object: _any,
    bool: _bool,
    int: _int,
    float: _float,
    str: _str,
    bytes: _bytes,
    type(None): _none,
    None: _none,
    datetime: _datetime,
}


def _instance(of: type) -> Convert:
    """Pictures and arrays are what their encoding says."""

    def convert(value: Any) -> Any:
        if isinstance(value, of):
            return value
        raise Misfit(f"a value of the type {name_of(of)}", described(value))

    return convert


def _union(members: list[tuple[Any, Convert]]) -> Convert:
    # A value that has the type of a member is not converted to another one: 3 stays an integer for `Union[float, int]`.
    exact = {of: convert for of, convert in members if isinstance(of, type)}

    def convert(value: Any) -> Any:
        if (own := exact.get(type(value))) is not None:
            return own(value)
        expected: list[str] = []
        misfits: list[Misfit] = []
        for _, one in members:
            try:
                return one(value)
            except Misfit as misfit:
                misfits.append(misfit)
                if misfit.expected not in expected:
                    expected.append(misfit.expected)
        # Of `Optional[Pose]`, the reason why it is no Pose says more than that it is not null.
        deepest = max(misfits, key=lambda misfit: len(misfit.steps))
        raise deepest if deepest.steps else Misfit(" or ".join(expected), described(value))

    return convert


def _one_of(values: dict[Any, Any]) -> Convert:
    expected = "one of " + ", ".join(repr(value) for value in values)
    # To Python, True is equal to 1.
    known = {(value, isinstance(value, bool)): member for value, member in values.items()}

    def convert(value: Any) -> Any:
        try:
            return known[value, isinstance(value, bool)]
        except (KeyError, TypeError):
            raise Misfit(expected, described(value)) from None

    return convert


def _list(item: Convert) -> Convert:
    def convert(value: Any) -> list[Any]:
        if type(value) is not list:
            value = _listed(value)
        converted: list[Any] = []
        try:
            for one in value:
                converted.append(item(one))
        except Misfit as misfit:
            raise misfit.within(len(converted)) from None
        return converted

    return convert


def _listed(value: Any) -> list[Any]:
    """Arrays of numbers arrive as arrays of numpy."""
    if isinstance(value, tuple):
        return list(value)
    if hasattr(value, "tolist") and getattr(value, "ndim", False):
        return cast("list[Any]", value.tolist())
    raise Misfit("a list", described(value))


def _tuple(arguments: tuple[Any, ...], outer: tuple[Any, ...]) -> Convert:
    if not arguments or arguments[1:] == (Ellipsis,):
        convert_all = _list(_converter(arguments[0] if arguments else Any, outer))
        return lambda value: tuple(convert_all(value))
    items = [_converter(argument, outer) for argument in arguments if argument != ()]

    def convert(value: Any) -> tuple[Any, ...]:
        value = value if type(value) is list else _listed(value)
        if len(value) != len(items):
            raise Misfit(f"a list of {len(items)}", described(value))
        converted: list[Any] = []
        try:
            for item, one in zip(items, value):
                converted.append(item(one))
        except Misfit as misfit:
            raise misfit.within(len(converted)) from None
        return tuple(converted)

    return convert


def _dict(key: Convert, item: Convert) -> Convert:
    def convert(value: Any) -> dict[Any, Any]:
        if type(value) is not dict:
            raise Misfit("an object", described(value))
        converted = {}
        for name, one in value.items():
            try:
                converted[_key(key, name)] = item(one)
            except Misfit as misfit:
                raise misfit.within(str(name)) from None
        return converted

    return convert


def _key(convert: Convert, name: Any) -> Any:
    """The keys of JSON are text, also where the sender's were numbers."""
    try:
        return convert(name)
    except Misfit:
        if type(name) is str and name.lstrip("-").isdecimal() and len(name) <= 20:
            return convert(int(name))
        raise


@dataclasses.dataclass
class _Field:
    """A field of a class: its name, the conversion of its value, and whether a value without it does not fit."""

    name: str
    convert: Convert
    required: bool


def _converted(fields: list[_Field], value: Any) -> dict[str, Any]:
    """Returns the fields of an object. Those that the class does not have are ignored."""
    if type(value) is not dict:
        raise Misfit("an object", described(value))
    converted = {}
    for field in fields:
        name = field.name
        if name in value:
            try:
                converted[name] = field.convert(value[name])
            except Misfit as misfit:
                raise misfit.within(name) from None
        elif field.required:
            raise Misfit("a value", "no such field").within(name)
    return converted


def _dataclass(of: type, outer: tuple[Any, ...]) -> Convert:
    hints = _hints(of)
    missing = dataclasses.MISSING
    fields = [
        _Field(
            field.name,
            _converter(hints[field.name], outer),
            field.default is missing and field.default_factory is missing,
        )
        for field in dataclasses.fields(of)
        if field.init
    ]

    def convert(value: Any) -> Any:
        arguments = _converted(fields, value)
        try:
            return of(**arguments)
        except (TypeError, ValueError) as error:
            # `__post_init__` of the program checks more than types.
            raise Misfit(f"a {name_of(of)}", f"one that it rejects: {error}") from None

    return convert


def _typed_dict(of: Any, outer: tuple[Any, ...]) -> Convert:
    fields = [_Field(name, _converter(hint, outer), name in of.__required_keys__) for name, hint in _hints(of).items()]
    return lambda value: _converted(fields, value)


def _hints(of: Any) -> dict[str, Any]:
    """Returns the types of the fields of a class, which may be text (`from __future__ import annotations`)."""
    try:
        return typing.get_type_hints(of)
    except NameError as error:
        advice = f"{error}. Define the classes outside of functions"
    except TypeError as error:
        advice = f"{error}. Before Python 3.10, write Optional[X] and Union[X, Y] in place of X | Y"
    raise TypeError(f"the types of the fields of {name_of(of)} cannot be resolved: {advice}")


def _pydantic(of: Any) -> Convert:
    """pydantic converts, and the first of its errors is reported."""

    def convert(value: Any) -> Any:
        try:
            return of.model_validate(value)
        except ValueError as error:
            first = cast(Any, error).errors(include_url=False, include_context=False)[0]
            expected = first["msg"].partition("Input should be ")[2] or first["msg"]
            found = "no such field" if first["type"] == "missing" else described(first["input"])
            misfit = Misfit("a value" if first["type"] == "missing" else expected, found)
            misfit.steps = list(reversed(first["loc"]))
            raise misfit from None

    return convert


def _msgspec(of: Any) -> Convert:
    """msgspec converts, and names the place in its error."""
    import msgspec

    def convert(value: Any) -> Any:
        try:
            return msgspec.convert(value, of)
        except msgspec.ValidationError as error:
            reason, _, place = str(error).partition(" - at `$")
            expected, _, found = reason.partition(", got ")
            misfit = Misfit(
                expected.removeprefix("Expected ").replace("`", ""), found.replace("`", "") or "another value"
            )
            if reason.startswith("Object missing required field `"):
                name = reason.removeprefix("Object missing required field `").rstrip("`")
                misfit = Misfit("a value", "no such field")
                place = f"{place.rstrip('`')}.{name}"
            misfit.steps = [place.rstrip("`").lstrip(".")] if place.rstrip("`") else []
            raise misfit from None

    return convert
