"""Tests the encoding and decoding of values, and the errors of values that cannot be encoded.

pytest rect-py/tests/test_values.py
"""

from __future__ import annotations

import dataclasses
import datetime
import enum
import io
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
from rect import _rect
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


@dataclasses.dataclass(frozen=True)
class Key:
    x: int


class Colour(enum.Enum):
    RED = "red"
    BLUE = 2


RECORDS = numpy.array([(1, 2.5), (3, 4.5)], [("a", "i4"), ("b", "f8")])


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ({numpy.int64(3): 1, numpy.str_("q"): 2, Colour.RED: 3, Colour.BLUE: 4}, {"3": 1, "q": 2, "red": 3, "2": 4}),
        ({"r": RECORDS}, {"r": [{"a": 1, "b": 2.5}, {"a": 3, "b": 4.5}]}),
        ({"r": RECORDS[1]}, {"r": {"a": 3, "b": 4.5}}),
        (RECORDS[1], {"a": 3, "b": 4.5}),
        ({"m": numpy.ma.array([1, 2], mask=[False, True])}, {"m": [1, None]}),
        ({"t": numpy.datetime64("2026-01-02T03:04:05.123456789")}, {"t": "2026-01-02T03:04:05.123456789"}),
        ({"t": numpy.datetime64("2026-01-02T03:04:05")}, {"t": "2026-01-02T03:04:05"}),
        ({"t": numpy.datetime64("2026-01-02")}, {"t": "2026-01-02"}),
        ([numpy.array(["2026-01-02"], "datetime64[ns]")], [["2026-01-02T00:00:00.000000000"]]),
        ([numpy.array("2026-01-02", "datetime64[D]")], ["2026-01-02"]),
        ([datetime.date(2026, 1, 2), datetime.time(3, 4)], ["2026-01-02", "03:04:00"]),
        (rect.Cbor({(1, (2, 3)): 4, None: 5, 1.5: 6}), {(1, (2, 3)): 4, None: 5, 1.5: 6}),
        (rect.Cbor([2**64, -(2**64) - 1, 2**128 - 1]), [2**64, -(2**64) - 1, 2**128 - 1]),
    ],
)
def test_values_are_exact(value: Any, expected: Any) -> None:
    assert payload_of(value).value == expected


def test_large_integers_in_json_keep_their_digits() -> None:
    text = b'[18446744073709551616, {"a": -123456789012345678901234567890}, 1e20, "18446744073709551616"]'
    assert rect.Payload(text, "application/json").value == [
        18446744073709551616,
        {"a": -123456789012345678901234567890},
        1e20,
        "18446744073709551616",
    ]


def test_equal_keys_of_cbor_are_refused() -> None:
    with pytest.raises(rect.PayloadError, match="keys of a map are equal"):
        _ = rect.Payload(b"\xa2\x01\x01\xf5\x02", "application/cbor").value


@pytest.mark.parametrize(
    ("encoding", "value"),
    [
        ("application/json; charset=utf-8", [1]),
        ("Application/JSON", [1]),
        ("text/json", [1]),
        ("application/geo+json", [1]),
        ("zenoh/string", "[1]"),
        ("TEXT/plain;charset=UTF-8", "[1]"),
        ("text/plain; charset=utf-16", b"[1]"),
        ("application/json;zstd", b"[1]"),
        ("zenoh/serialized", b"[1]"),
    ],
)
def test_media_types_are_compared_without_case_and_parameters(encoding: str, value: Any) -> None:
    assert rect.Payload(b"[1]", encoding).value == value


def test_pictures_with_parameters_are_decoded() -> None:
    png = payload_of(numpy.zeros((2, 3), numpy.uint8), rect.Codec("png"))
    assert rect.Payload(png.bytes, "IMAGE/PNG; name=x.png").value == png.value


def without_huffman_tables(jpeg: bytes) -> bytes:
    parts, at = [jpeg[:2]], 2
    while jpeg[at + 1] != 0xDA:
        end = at + 2 + int.from_bytes(jpeg[at + 2 : at + 4], "big")
        if jpeg[at + 1] != 0xC4:
            parts.append(jpeg[at:end])
        at = end
    return b"".join([*parts, jpeg[at:]])


@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_mjpg_of_usb_cameras_is_decoded(mode: str) -> None:
    # Pillow writes the standard tables, like cameras that leave them out.
    file = io.BytesIO()
    PIL.Image.linear_gradient("L").convert(mode).save(file, "JPEG")
    whole = rect.Payload(file.getvalue(), "image/jpeg")
    camera = rect.Payload(without_huffman_tables(whole.bytes), "image/jpeg")
    assert len(camera.bytes) < len(whole.bytes)
    assert camera.value == whole.value


def test_message_is_shown_in_a_notebook_although_it_cannot_be_decoded() -> None:
    fields = ("wombat-2", None, "arm", "normal", None, None, None, 0, False, False, None, None)
    message: rect.Message[Any] = rect.Message(_rect.MessageMetadata(fields), rect.Payload(b"{", "application/json"))
    assert "not valid JSON" in message._repr_html_()
    assert "not valid JSON" in repr(message)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ({"arm": {"angle": object()}}, "its field arm.angle is of the type object"),
        ({"arm": [1, 2j]}, "its field arm[1] is of the type complex"),
        ({"x": b"1"}, "its field x is bytes, which JSON cannot represent"),
        ({"x": math.nan}, "its field x is NaN"),
        ({"x": 2**64}, "its field x is an integer of more than 64 bits, which most programs cannot read in JSON"),
        (rect.Cbor({"x": 2**128}), "its field x is an integer of more than 128 bits: send it as text"),
        ({1: 1, "1": 2}, "has the key 1 twice"),
        ({1.5: 1}, "has the key 1.5; keys must be str or int in JSON"),
        (rect.Cbor({Key(1): 1}), "has the key Key(x=1); keys must be values without a dict in CBOR"),
        ({"t": datetime.timedelta(1)}, "its field t is a duration: send a number"),
        ({"t": numpy.timedelta64(3, "s")}, "its field t is a duration: send a number"),
        ({"t": numpy.datetime64("NaT")}, "its field t is NaT, which is not a time: send None"),
        (numpy.array([3], "datetime64[ns]"), "within a dict or list, as JSON"),
        (numpy.zeros(2, [("a", "i4")]), "within a dict or list, as JSON"),
        (numpy.zeros(2, bool), "publish array.tolist() as JSON"),
        (numpy.ma.array([1, 2], mask=[False, True]), "array.filled(value)"),
        (PIL.Image.new("I;16", (2, 2)), "publish numpy.asarray(image), which keeps all bits"),
        (PIL.Image.new("I", (2, 2)), "publish numpy.asarray(image), which keeps all bits"),
        (PIL.Image.new("F", (2, 2)), "publish numpy.asarray(image), which keeps all bits"),
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
    with pytest.raises(rect.PayloadError, match=r"float64, 3x3.*\(array \* 255\).astype\('uint8'\)"):
        payload_of(numpy.zeros((3, 3)), rect.Codec("jpeg"))
    with pytest.raises(rect.PayloadError, match=r"uint16, 3x3.*Publish it as an array"):
        payload_of(numpy.zeros((3, 3), numpy.uint16), rect.Codec("png"))
    with pytest.raises(rect.PayloadError, match=r"array.filled"):
        payload_of(numpy.ma.array(numpy.zeros((1, 2), numpy.uint8), mask=[[False, True]]), rect.Codec("png"))
    with pytest.raises(TypeError, match="not dict"):
        payload_of({}, rect.Codec("png"))
    with pytest.raises(rect.CodecError, match="11 bytes are not the size of 2x2 rgb8"):
        rect.Picture.of_pixels(2, 2, "rgb8", bytes(11))


def test_deeply_nested_json_raises_payload_error() -> None:
    for deep in (b"[" * 100_000, b"[" * 200 + b"]" * 200):
        with pytest.raises(rect.PayloadError, match="recursion"):
            _ = rect.Payload(deep, "application/json").value
