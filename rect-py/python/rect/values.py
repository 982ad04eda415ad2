"""Owns values: how what a program says becomes bytes with an encoding, and what came becomes a value again.

What the bytes are, the Rust library decides. numpy and Pillow are imported only where a value of theirs is given or
asked for.
"""

from __future__ import annotations

import builtins
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rect import _rect
from rect.errors import PayloadError

if TYPE_CHECKING:
    import numpy
    import PIL.Image
    from typing_extensions import TypeGuard

BYTES = "zenoh/bytes"
TEXT = "text/plain"
JSON = "application/json"
CBOR = "application/cbor"
_RAW = "application/octet-stream"
_PICTURES = ("image/png", "image/jpeg", "image/webp")
_PICTURE_CODECS = ("png", "jpeg", "webp")
_CHANNELS = {"grey8": 1, "rgb8": 3, "rgba8": 4}
_MODES = {"grey8": "L", "rgb8": "RGB", "rgba8": "RGBA"}
#: What goes as JSON, as most messages do.
_PLAIN = frozenset((dict, list, float, int, bool, type(None)))
#: So many characters are never more bytes than an encoding may have.
_SHORT_ENCODING = 50
_ELEMENTS = ("u8", "i8", "u16", "i16", "u32", "i32", "i64", "f32", "f64")


class Payload:
    """Bytes, and what they are: an encoding as Zenoh's tools show it.

    >>> Payload(b"[1, 2]", "application/json").value
    [1, 2]
    """

    # No dataclass: a frozen one takes four times as long to make, and each message has two.
    __slots__ = ("bytes", "encoding")
    __match_args__ = ("bytes", "encoding")

    bytes: builtins.bytes
    encoding: str

    def __init__(self, bytes: builtins.bytes, encoding: str = BYTES) -> None:
        self.bytes = bytes
        self.encoding = encoding

    @property
    def value(self) -> Any:
        """What it says: a dict, text, a numpy array, a `Picture`...; bytes where the encoding is not known here.

        Raises `PayloadError` where the bytes are not what the encoding says.
        """
        return value_of(self)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Payload):
            return NotImplemented
        return (self.bytes, self.encoding) == (other.bytes, other.encoding)

    def __hash__(self) -> int:
        return hash((self.bytes, self.encoding))

    def __repr__(self) -> str:
        return f"Payload({len(self.bytes)} bytes, {self.encoding})"


@dataclass(frozen=True)
class Cbor:
    """Sends a value as CBOR: shorter than JSON, bytes and NaN included, and not readable by eye.

    >>> payload_of(Cbor({"angle": 12.5})).encoding
    'application/cbor'
    """

    value: Any


class Picture:
    """A picture as a camera gives it: rows of pixels without gaps, from the upper left.

    `numpy.asarray(picture)` has its pixels, `picture.pillow()` is the same for Pillow.

    >>> Picture.of_pixels(2, 1, "rgb8", bytes(6))
    Picture(2x1 rgb8)
    """

    __slots__ = ("format", "height", "pixels", "width")

    width: int
    height: int
    #: `grey8`, `rgb8` or `rgba8`.
    format: str
    pixels: bytes

    def __init__(self, picture: numpy.ndarray[Any, Any] | PIL.Image.Image | Picture) -> None:
        """Of a numpy array of bytes (height x width, or height x width x 3 or 4), or of a Pillow image."""
        size: tuple[int, int, str, bytes]
        if isinstance(picture, Picture):
            size = (picture.width, picture.height, picture.format, picture.pixels)
        elif _is_array(picture):
            size = _pixels_of_array(picture)
        elif _is_pillow(picture):
            size = _pixels_of_pillow(picture)
        else:
            name = type(picture).__name__
            raise TypeError(f"picture is a numpy array, a Pillow image or a rect.Picture, not a {name}")
        self.width, self.height, self.format, self.pixels = size
        _rect.picture(*size)

    @classmethod
    def of_pixels(cls, width: int, height: int, format: str, pixels: bytes) -> Picture:
        """Of pixels, `grey8`, `rgb8` or `rgba8`. Raises `CodecError` where it is another number of bytes."""
        _rect.picture(width, height, format, pixels)
        made = cls.__new__(cls)
        made.width, made.height, made.format, made.pixels = width, height, format, pixels
        return made

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> numpy.ndarray[Any, Any]:
        import numpy

        channels = _CHANNELS[self.format]
        shape = (self.height, self.width) if channels == 1 else (self.height, self.width, channels)
        array = numpy.frombuffer(self.pixels, numpy.uint8).reshape(shape)
        return array if dtype is None else array.astype(dtype)

    def numpy(self) -> numpy.ndarray[Any, Any]:
        """Its pixels, height x width (x 3 or 4)."""
        return self.__array__()

    def pillow(self) -> PIL.Image.Image:
        """The same for Pillow."""
        import PIL.Image

        return PIL.Image.frombytes(_MODES[self.format], (self.width, self.height), self.pixels)

    def scaled(self, width: int, height: int) -> Picture:
        """The same in another size."""
        return Picture.of_pixels(*_rect.scaled((self.width, self.height, self.format), self.pixels, (width, height)))

    def _repr_png_(self) -> bytes:
        return _rect.Codec("png").encode(*_raw_picture(self))[0]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Picture):
            return NotImplemented
        return (self.width, self.height, self.format, self.pixels) == (
            other.width,
            other.height,
            other.format,
            other.pixels,
        )

    def __hash__(self) -> int:
        return hash((self.width, self.height, self.format, self.pixels))

    def __repr__(self) -> str:
        return f"Picture({self.width}x{self.height} {self.format})"


def payload_of(value: Any, codec: _rect.Codec | None = None) -> Payload:
    """A value as it is sent, made smaller by a codec if there is one."""
    if codec is None:
        bytes, encoding = _parts(value)
    else:
        if codec.name.split(":")[0] in _PICTURE_CODECS and not isinstance(value, (Payload, builtins.bytes)):
            value = Picture(value)
        bytes, encoding = codec.encode(*_parts(value))
    if len(encoding) > _SHORT_ENCODING:
        _rect.check_encoding(encoding)
    return Payload(bytes, encoding)


def value_of(payload: Payload) -> Any:
    """What a payload says, by its encoding."""
    if payload.encoding in (JSON, CBOR, "text/json"):
        return _rect.read_value(payload.bytes, payload.encoding)
    media_type, _, rest = payload.encoding.partition(";")
    if media_type.startswith("text/"):
        try:
            return payload.bytes.decode()
        except UnicodeDecodeError as error:
            text = f"the payload says that it is text, and is not, or not of the wanted shape: {error}"
            raise PayloadError(text, "read") from None
    if media_type in _PICTURES or (media_type == _RAW and rest.startswith("picture;")):
        return Picture.of_pixels(*_rect.read_picture(payload.bytes, payload.encoding))
    if media_type == _RAW and (rest.startswith("array;") or rest == "quantised"):
        return _numpy_of(payload)
    return payload.bytes


def codec_of(codec: str | _rect.Codec | None) -> _rect.Codec | None:
    """The codec that a program names, as `zstd:9` or `jpeg:60`."""
    if codec is None or isinstance(codec, _rect.Codec):
        return codec
    if isinstance(codec, str):
        return _rect.Codec(codec)
    raise TypeError(f"codec is text such as 'zstd:9', or a rect.Codec, not a {type(codec).__name__}")


def _parts(value: Any) -> tuple[bytes, str]:
    if type(value) in _PLAIN:
        return _rect.write_value(value)
    if isinstance(value, str):
        try:
            return value.encode(), TEXT
        except UnicodeEncodeError as error:
            raise PayloadError(f"this value can't be written as text: {error}", "write") from None
    if isinstance(value, bytes):
        return value, BYTES
    if isinstance(value, Payload):
        return _checked(value)
    if isinstance(value, Cbor):
        return _rect.write_value(value.value, True)
    if isinstance(value, (bytearray, memoryview)):
        return bytes(value), BYTES
    if isinstance(value, Picture):
        return _raw_picture(value)
    if _is_array(value):
        return _raw_array(value)
    if _is_pillow(value):
        return _raw_picture(Picture(value))
    return _rect.write_value(value)


def _checked(payload: Payload) -> tuple[bytes, str]:
    """What a program's own payload has, if it can be sent."""
    if not isinstance(payload.bytes, bytes):
        raise TypeError(f"a payload has bytes, not a {type(payload.bytes).__name__}")
    if not isinstance(payload.encoding, str):
        raise TypeError(f"an encoding is text, not a {type(payload.encoding).__name__}")
    try:
        payload.encoding.encode()
    except UnicodeEncodeError as error:
        raise PayloadError(f"this encoding is not text in UTF-8: {error}", "encoding") from None
    return payload.bytes, payload.encoding


def _raw_picture(picture: Picture) -> tuple[bytes, str]:
    return picture.pixels, _rect.picture_encoding(picture.width, picture.height, picture.format, picture.pixels)


def _raw_array(array: numpy.ndarray[Any, Any]) -> tuple[bytes, str]:
    import numpy

    kind = f"{array.dtype.kind}{array.dtype.itemsize * 8}"
    if kind not in _ELEMENTS:
        # numpy counts bytes, this library bits: "f4" is f32.
        raise PayloadError(f"an array of {array.dtype} can't be sent: {', '.join(_ELEMENTS)} can", "write")
    little = numpy.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    numbers = little.tobytes()
    return numbers, _rect.array_encoding(kind, list(array.shape), numbers)


def _numpy_of(payload: Payload) -> numpy.ndarray[Any, Any]:
    element, shape, numbers = _rect.read_array(payload.bytes, payload.encoding)
    try:
        import numpy
    except ImportError:
        raise PayloadError("an array came, for which numpy is needed: `pip install numpy`") from None
    dtype = numpy.dtype(f"<{element[0]}{int(element[1:]) // 8}")
    return numpy.frombuffer(numbers, dtype).reshape(shape)


def _pixels_of_array(array: numpy.ndarray[Any, Any]) -> tuple[int, int, str, bytes]:
    channels = 1 if array.ndim == 2 else array.shape[-1]
    formats = {count: name for name, count in _CHANNELS.items()}
    if array.dtype != "uint8" or array.ndim not in (2, 3) or channels not in formats:
        found = f"{array.dtype}, {'x'.join(map(str, array.shape))}"
        text = f"this array is no picture: bytes of height x width (x 1, 3 or 4) are, and it is {found}"
        raise PayloadError(text, "write")
    return int(array.shape[1]), int(array.shape[0]), formats[channels], array.tobytes()


def _pixels_of_pillow(image: PIL.Image.Image) -> tuple[int, int, str, bytes]:
    modes = {mode: name for name, mode in _MODES.items()}
    if image.mode not in modes:
        image = image.convert("RGBA" if "transparency" in image.info or "A" in image.mode else "RGB")
    return image.width, image.height, modes[image.mode], image.tobytes()


def _is_array(value: Any) -> TypeGuard[numpy.ndarray[Any, Any]]:
    numpy = sys.modules.get("numpy")
    return numpy is not None and isinstance(value, numpy.ndarray)


def _is_pillow(value: Any) -> TypeGuard[PIL.Image.Image]:
    image = sys.modules.get("PIL.Image")
    return image is not None and isinstance(value, image.Image)
