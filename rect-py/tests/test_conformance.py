"""Runs the test vectors in `tests/conformance/*.json`, which apply to every language.

pytest rect-py/tests/test_conformance.py
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rect
from rect import _rect

_VECTORS = Path(__file__).resolve().parents[2] / "tests" / "conformance"
#: Limits of the decoders that all vectors assume.
_MAX_BYTES = 65_536
_MAX_PIXELS = 4096


def cases(file: str) -> list[Any]:
    """Returns the cases of a file: the input (`in`) and the expected output (`out`) of each."""
    vectors = json.loads((_VECTORS / f"{file}.json").read_text())["cases"]
    assert vectors, file
    return [pytest.param(case["in"], case["out"], id=str(n)) for n, case in enumerate(vectors)]


def kind(error: rect.PayloadError) -> dict[str, Any]:
    """Returns an error in the form of the vectors: its kind, and the id of the missing dictionary, if any."""
    dictionary = getattr(error, "dictionary", None)
    return {"error": error.kind} if dictionary is None else {"error": error.kind, "id": dictionary}


def is_valid(check: Callable[[], object]) -> bool:
    try:
        check()
    except rect.RectError:
        return False
    return True


def test_every_vector_file_has_a_test() -> None:
    names = {
        "names",
        "topics",
        "patterns",
        "keys",
        "attachments",
        "encodings",
        "codecs",
        "dictionaries",
        "compressed",
        "pictures",
        "arrays",
    }
    assert {file.stem for file in _VECTORS.glob("*.json")} == names


@pytest.mark.parametrize(("given", "out"), cases("names"))
def test_name_validation(given: str, out: bool) -> None:
    assert is_valid(lambda: _rect.check_name(given)) == out


@pytest.mark.parametrize(("given", "out"), cases("topics"))
def test_topic_validation(given: str, out: bool) -> None:
    assert is_valid(lambda: _rect.check_topic(given)) == out


@pytest.mark.parametrize(("given", "out"), cases("patterns"))
def test_patterns(given: str, out: Any) -> None:
    try:
        robot, topic = _rect.pattern(given)
    except rect.RectError:
        assert out is None
    else:
        assert out == {"robot": robot, "topic": topic}


@pytest.mark.parametrize(("given", "out"), cases("keys"))
def test_keys(given: dict[str, Any], out: Any) -> None:
    key_space = _rect.KeySpace(given["fleet"], given["robot"])
    found: Any
    if given["do"] == "publication":
        found = key_space.publication(given["topic"])
    elif given["do"] == "message":
        found = key_space.publication(given["topic"], given["recipient"])
    elif given["do"] == "service":
        found = key_space.service(given["of"], given["topic"])
    elif given["do"] == "own":
        found = key_space.own(given["of"], given["rest"])
    elif given["do"] == "subscriptions":
        found = _rect.Inbound(key_space, given["pattern"]).keys()
    else:
        address = key_space.address(given["key"])
        found = None if address is None else dict(zip(("sender", "recipient", "topic"), address))
    assert found == out


@pytest.mark.parametrize(("given", "out"), cases("attachments"))
def test_attachments(given: str, out: Any) -> None:
    fields = _rect.read_attachment(bytes.fromhex(given))
    if fields is None:
        assert out is None
        return
    assert out == dict(zip(("source", "sequence", "at_ms", "low", "recorded_ms"), fields))
    assert _rect.write_attachment(*fields).hex() == given


@pytest.mark.parametrize(("given", "out"), cases("encodings"))
def test_encoding_parts(given: str, out: dict[str, Any]) -> None:
    parts = (*_rect.encoding_parts(given), _rect.encoding_kind(given))
    assert dict(zip(("media_type", "schema", "below", "kind"), parts)) == out


@pytest.mark.parametrize(("given", "out"), cases("codecs"))
def test_codec_names(given: str, out: Any) -> None:
    try:
        found: Any = rect.Codec(given).name
    except rect.CodecError as error:
        found = kind(error)
    assert found == out


@pytest.mark.parametrize(("given", "out"), cases("dictionaries"))
def test_dictionary_ids(given: str, out: int | None) -> None:
    try:
        found = rect.Dictionary(bytes.fromhex(given)).id
    except rect.DictionaryError:
        assert out is None
    else:
        assert found == out


@pytest.mark.parametrize(("given", "out"), cases("compressed"))
def test_compressed_payloads(given: dict[str, str], out: Any) -> None:
    dictionary = given.get("dictionary")
    dictionaries = [] if dictionary is None else [rect.Dictionary(bytes.fromhex(dictionary))]
    try:
        decoded, encoding = _rect.decode(bytes.fromhex(given["bytes"]), given["encoding"], dictionaries, _MAX_BYTES)
        found = {"encoding": encoding, "bytes": decoded.hex()}
    except rect.CodecError as error:
        found = kind(error)
    assert found == out


@pytest.mark.parametrize(("given", "out"), cases("pictures"))
def test_pictures(given: dict[str, Any], out: Any) -> None:
    try:
        picture = _rect.read_picture(bytes.fromhex(given["bytes"]), given["encoding"], _MAX_BYTES, _MAX_PIXELS)
    except rect.PayloadError as error:
        assert kind(error) == out
        return
    width, height, form, pixels = picture
    assert (width, height, form) == (out["width"], out["height"], out["format"])
    expected = bytes.fromhex(out["pixels"])
    assert len(pixels) == len(expected)
    # Decoders of lossy pictures round differently.
    assert max(abs(a - b) for a, b in zip(pixels, expected)) <= (out.get("off") or 0)


@pytest.mark.parametrize(("given", "out"), cases("arrays"))
def test_arrays(given: dict[str, str], out: Any) -> None:
    try:
        element, shape, numbers = _rect.read_array(bytes.fromhex(given["bytes"]), given["encoding"], _MAX_BYTES)
        found: Any = {"element": element, "shape": shape, "bytes": numbers.hex()}
    except rect.PayloadError as error:
        found = kind(error)
    assert found == out
