"""Tests the encoding and decoding of values, and the errors of values that cannot be encoded.

pytest rect-py/tests/test_values.py
"""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy
import PIL.Image
import pytest
import rect
from hypothesis import given
from hypothesis import strategies as some
from hypothesis.extra import numpy as some_numpy
from rect.values import payload_of

_TEXT = some.text(some.characters(exclude_categories=["Cs"]))
_INTEGERS = some.integers(-(2**63), 2**64 - 1)
_PLAIN = some.none() | some.booleans() | _INTEGERS | _TEXT
_FINITE = some.floats(allow_nan=False, allow_infinity=False)
_JSON = some.recursive(_PLAIN | _FINITE, lambda inner: some.lists(inner) | some.dictionaries(_TEXT, inner))
_KEYS = _TEXT | _INTEGERS
_CBOR = some.recursive(
    _PLAIN | some.floats(allow_nan=False) | some.binary(),
    lambda inner: some.lists(inner) | some.dictionaries(_KEYS, inner),
)
_NUMBERS = some.sampled_from(["u1", "i1", "u2", "i2", "u4", "i4", "i8", "f4", "f8", ">f8", ">i4"])


@given(_JSON)
def test_json_round_trip(value: Any) -> None:
    payload = payload_of(value)
    if isinstance(value, str):
        assert payload.encoding == "text/plain"
    else:
        assert payload.encoding == "application/json"
        assert json.loads(payload.bytes) == value
    assert payload.value == value


@given(_CBOR)
def test_cbor_round_trip(value: Any) -> None:
    payload = payload_of(rect.Cbor(value))
    assert (payload.encoding, payload.value) == ("application/cbor", value)


@given(some.binary())
def test_bytes_round_trip(value: bytes) -> None:
    for given_as in (value, bytearray(value), memoryview(value)):
        assert payload_of(given_as) == rect.Payload(value, "zenoh/bytes")
    assert payload_of(value).value == value


@given(some_numpy.arrays(_NUMBERS, some_numpy.array_shapes(min_dims=1, max_dims=8, max_side=4)))
def test_array_round_trip(array: numpy.ndarray[Any, Any]) -> None:
    for given_as in (array, array.T):
        back = payload_of(given_as).value
        assert back.shape == given_as.shape
        assert back.dtype == given_as.dtype.newbyteorder("=")
        assert numpy.array_equal(back, given_as, equal_nan=array.dtype.kind == "f")


@given(some_numpy.arrays("u1", some.sampled_from([(3, 4), (3, 4, 3), (3, 4, 4)])), some.sampled_from(["png", "zstd:9"]))
def test_picture_round_trip(array: numpy.ndarray[Any, Any], codec: str) -> None:
    picture = rect.Picture(array)
    payload = payload_of(picture, rect.Codec(codec))
    if codec.startswith("zstd"):
        from rect import _rect

        payload = rect.Payload(*_rect.decode(payload.bytes, payload.encoding, []))
    assert payload.value == picture
    assert numpy.array_equal(numpy.asarray(payload.value), array)
    assert rect.Picture(payload.value.pillow()) == picture


@given(_JSON, some.integers(1, 19))
def test_compressed_payload_round_trip(value: Any, level: int) -> None:
    from rect import _rect

    compressed = payload_of(value, rect.Codec(f"zstd:{level}"))
    assert rect.Payload(*_rect.decode(compressed.bytes, compressed.encoding, [])).value == value


@given(
    some.binary(), some.sampled_from(["application/json", "application/cbor", "text/plain", "image/png", "image/jpeg"])
)
def test_random_bytes_decode_or_raise_payload_error(junk: bytes, encoding: str) -> None:
    try:
        _ = rect.Payload(junk, encoding).value
    except rect.PayloadError as error:
        assert str(error)


@given(some.binary(), some.text())
def test_unknown_encoding_returns_bytes(junk: bytes, rest: str) -> None:
    assert rect.Payload(junk, f"application/x-{rest}").value == junk


@dataclasses.dataclass
class Arm:
    angle: float
    joints: tuple[int, ...]


@dataclasses.dataclass
class Reading:
    name: str
    arm: Arm


def test_dataclass_is_encoded_as_its_fields() -> None:
    value = payload_of(Reading("left", Arm(1.5, (1, 2)))).value
    assert value == {"name": "left", "arm": {"angle": 1.5, "joints": [1, 2]}}


def test_numpy_values_inside_containers_are_encoded() -> None:
    value = {"x": numpy.float32(0.5), "on": numpy.bool_(True), "all": numpy.arange(3)}
    assert payload_of(value).value == {"x": 0.5, "on": True, "all": [0, 1, 2]}


def test_json_matches_rust_library() -> None:
    value = {"ä": [1.0, 0.1, None, True, "a\n"], "n": -1}
    assert payload_of(value).bytes.decode() == '{"ä":[1.0,0.1,null,true,"a\\n"],"n":-1}'


def test_pillow_modes_are_converted() -> None:
    for mode, form in [
        ("L", "grey8"),
        ("RGB", "rgb8"),
        ("RGBA", "rgba8"),
        ("P", "rgb8"),
        ("1", "rgb8"),
        ("LA", "rgba8"),
    ]:
        assert payload_of(PIL.Image.new(mode, (4, 3))).value.format == form


def test_lossy_picture_is_close_to_original() -> None:
    grey = numpy.full((24, 32, 3), 100, numpy.uint8)
    for codec in ("jpeg:90", "webp:90"):
        back = numpy.asarray(payload_of(grey, rect.Codec(codec)).value)
        assert back.shape == grey.shape
        assert numpy.abs(back.astype(int) - 100).max() < 8


def test_quantised_array_is_within_error_bound() -> None:
    array = numpy.linspace(-1, 1, 100, dtype=numpy.float32).reshape(10, 10)
    payload = payload_of(array, rect.Codec("quantised:0.01"))
    assert payload.encoding == "application/octet-stream;quantised"
    assert numpy.abs(payload.value - array).max() <= 0.0101


def test_picture_has_png_representation() -> None:
    assert rect.Picture.of_pixels(1, 1, "grey8", b"\0")._repr_png_().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ({"arm": {"angle": object()}}, "its field arm.angle is of the type object"),
        ({"arm": [1, 2j]}, "its field arm[1] is of the type complex"),
        ({"x": b"1"}, "its field x is bytes, which JSON cannot represent"),
        ({"x": math.nan}, "its field x is NaN"),
        ({"x": 2**64}, "its field x is an integer of more than 64 bits"),
        ({"a": {None: 1}}, "its field a has the key None; keys must be str or int in JSON"),
        ({"a": "\ud800"}, "its field a is text that is not UTF-8"),
        (object(), "the value is of the type object"),
        ("\ud800", "cannot be encoded as text"),
        (numpy.zeros(2, complex), "an array of complex128 cannot be sent"),
        (numpy.array(["a"]), "cannot be sent"),
    ],
)
def test_unsupported_value_is_named(value: Any, text: str) -> None:
    with pytest.raises(rect.PayloadError, match=r"\S") as error:
        payload_of(value)
    assert text in str(error.value)
    assert error.value.kind == "write"


def test_value_that_contains_itself_raises_payload_error() -> None:
    circle: list[Any] = []
    circle.append(circle)
    for value in (circle, rect.Cbor(circle)):
        with pytest.raises(rect.PayloadError, match="nested too deeply"):
            payload_of(value)


def test_invalid_picture_is_named() -> None:
    with pytest.raises(rect.PayloadError, match=r"float64, 3x3"):
        payload_of(numpy.zeros((3, 3)), rect.Codec("jpeg"))
    with pytest.raises(TypeError, match="not dict"):
        payload_of({}, rect.Codec("png"))
    with pytest.raises(rect.CodecError, match="11 bytes are not the size of 2x2 rgb8"):
        rect.Picture.of_pixels(2, 2, "rgb8", bytes(11))


def test_deeply_nested_json_raises_payload_error() -> None:
    for deep in (b"[" * 100_000, b"[" * 200 + b"]" * 200):
        with pytest.raises(rect.PayloadError, match="recursion"):
            _ = rect.Payload(deep, "application/json").value
