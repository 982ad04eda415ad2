"""What must be equal in every language, as vectors in `tests/conformance/*.json` of the repository: Python's turn.

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
#: Those of every file.
_MAX_BYTES = 65_536
_MAX_PIXELS = 4096


def cases(file: str) -> list[Any]:
    """Each `in` with its `out`."""
    vectors = json.loads((_VECTORS / f"{file}.json").read_text())["cases"]
    assert vectors, file
    return [pytest.param(case["in"], case["out"], id=str(n)) for n, case in enumerate(vectors)]


def kind(error: rect.PayloadError) -> dict[str, Any]:
    dictionary = getattr(error, "dictionary", None)
    return {"error": error.kind} if dictionary is None else {"error": error.kind, "id": dictionary}


def holds(check: Callable[[], object]) -> bool:
    try:
        check()
    except rect.RectError:
        return False
    return True


def test_every_file_of_vectors_is_run() -> None:
    known = {
        "names",
        "topics",
        "patterns",
        "keys",
        "attachments",
        "encodings",
        "codecs",
        "dictionaries",
        "packings",
        "pictures",
        "arrays",
    }
    assert {file.stem for file in _VECTORS.glob("*.json")} == known


@pytest.mark.parametrize(("given", "out"), cases("names"))
def test_names_are_told_from_what_is_none(given: str, out: bool) -> None:
    assert holds(lambda: _rect.check_name(given)) == out


@pytest.mark.parametrize(("given", "out"), cases("topics"))
def test_topics_are_told_from_what_is_none(given: str, out: bool) -> None:
    assert holds(lambda: _rect.check_topic(given)) == out


@pytest.mark.parametrize(("given", "out"), cases("patterns"))
def test_patterns_mean_the_same(given: str, out: Any) -> None:
    try:
        robot, topic = _rect.pattern(given)
    except rect.RectError:
        assert out is None
    else:
        assert out == {"robot": robot, "topic": topic}


@pytest.mark.parametrize(("given", "out"), cases("keys"))
def test_keys_are_made_and_read_alike(given: dict[str, Any], out: Any) -> None:
    place = _rect.Place(given["fleet"], given["robot"])
    found: Any
    if given["do"] == "publication":
        found = place.publication(given["topic"])
    elif given["do"] == "message":
        found = place.message(given["to"], given["topic"])
    elif given["do"] == "service":
        found = place.service(given["of"], given["topic"])
    elif given["do"] == "own":
        found = place.own(given["of"], given["rest"])
    elif given["do"] == "subscriptions":
        found = list(place.subscriptions(given["pattern"]))
    else:
        address = place.address(given["key"])
        found = None if address is None else dict(zip(("from", "to", "topic"), address))
    assert found == out


@pytest.mark.parametrize(("given", "out"), cases("attachments"))
def test_attachments_are_read_alike_and_written_back(given: str, out: Any) -> None:
    told = _rect.read_attachment(bytes.fromhex(given))
    if told is None:
        assert out is None
        return
    assert out == dict(zip(("source", "sequence", "at_ms", "low"), told))
    assert _rect.write_attachment(*told).hex() == given


@pytest.mark.parametrize(("given", "out"), cases("encodings"))
def test_encodings_have_the_same_parts(given: str, out: dict[str, Any]) -> None:
    assert dict(zip(("media_type", "schema", "below"), _rect.encoding_parts(given))) == out


@pytest.mark.parametrize(("given", "out"), cases("codecs"))
def test_codecs_have_the_same_names(given: str, out: Any) -> None:
    try:
        found: Any = rect.Codec(given).name
    except rect.CodecError as error:
        found = kind(error)
    assert found == out


@pytest.mark.parametrize(("given", "out"), cases("dictionaries"))
def test_dictionaries_have_the_same_id(given: str, out: int | None) -> None:
    try:
        found = rect.Dictionary(bytes.fromhex(given)).id
    except rect.DictionaryError:
        assert out is None
    else:
        assert found == out


@pytest.mark.parametrize(("given", "out"), cases("packings"))
def test_packings_are_undone_alike(given: dict[str, str], out: Any) -> None:
    dictionary = given.get("dictionary")
    known = [] if dictionary is None else [rect.Dictionary(bytes.fromhex(dictionary))]
    try:
        undone, encoding = _rect.unpack(bytes.fromhex(given["bytes"]), given["encoding"], known, _MAX_BYTES)
        found = {"encoding": encoding, "bytes": undone.hex()}
    except rect.CodecError as error:
        found = kind(error)
    assert found == out


@pytest.mark.parametrize(("given", "out"), cases("pictures"))
def test_pictures_are_read_alike(given: dict[str, Any], out: Any) -> None:
    try:
        seen = _rect.read_picture(bytes.fromhex(given["bytes"]), given["encoding"], _MAX_BYTES, _MAX_PIXELS)
    except rect.PayloadError as error:
        assert kind(error) == out
        return
    width, height, form, pixels = seen
    assert (width, height, form) == (out["width"], out["height"], out["format"])
    wanted = bytes.fromhex(out["pixels"])
    assert len(pixels) == len(wanted)
    # Decoders of pictures with loss round differently.
    assert max(abs(a - b) for a, b in zip(pixels, wanted)) <= (out.get("off") or 0)


@pytest.mark.parametrize(("given", "out"), cases("arrays"))
def test_arrays_are_read_alike(given: dict[str, str], out: Any) -> None:
    try:
        element, shape, numbers = _rect.read_array(bytes.fromhex(given["bytes"]), given["encoding"], _MAX_BYTES)
        found: Any = {"element": element, "shape": shape, "bytes": numbers.hex()}
    except rect.PayloadError as error:
        found = kind(error)
    assert found == out
