"""Converts values to payloads (bytes with an encoding), and payloads to values.

The Rust library defines the bytes. numpy and Pillow are imported only when a value of theirs is passed or requested.
"""

from __future__ import annotations

import builtins
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rect import _rect
from rect.choices import PixelFormat
from rect.errors import PayloadError

if TYPE_CHECKING:
    import numpy
    import PIL.Image
    from typing_extensions import TypeGuard

BYTES = "zenoh/bytes"
TEXT = "text/plain"
JSON = "application/json"
CBOR = "application/cbor"
_PICTURE_CODECS = ("png", "jpeg", "webp")
_CHANNELS: dict[PixelFormat, int] = {"grey8": 1, "rgb8": 3, "rgba8": 4}
_MODES: dict[PixelFormat, str] = {"grey8": "L", "rgb8": "RGB", "rgba8": "RGBA"}
#: Types of most values; they are sent as JSON.
_PLAIN = frozenset((dict, list, float, int, bool, type(None)))
#: An encoding of at most this many characters never exceeds the maximum length in bytes.
_SHORT_ENCODING = 50
_ELEMENTS = ("u8", "i8", "u16", "i16", "u32", "i32", "i64", "f32", "f64")


class Payload:
    """Bytes with their encoding, in the form that Zenoh's tools show.

    >>> Payload(b"[1, 2]", "application/json").value
    [1, 2]
    """

    # Not a dataclass: a frozen one takes four times as long to construct, and each message needs two.
    __slots__ = ("bytes", "encoding")
    __match_args__ = ("bytes", "encoding")

    #: The encoded value.
    bytes: builtins.bytes
    #: The encoding, such as `application/json`. Default: `zenoh/bytes`.
    encoding: str

    def __init__(self, bytes: builtins.bytes, encoding: str = BYTES) -> None:
        self.bytes = bytes
        self.encoding = encoding

    @property
    def value(self) -> Any:
        """The decoded bytes: a dict, text, a numpy array, a `Picture` and so on, or bytes if the encoding is unknown.

        Raises `PayloadError` if the bytes do not match the encoding.
        """
        return value_of(self)

    def __reduce__(self) -> tuple[Any, ...]:
        return reduced(self)

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
    """Wraps a value so that it is sent as CBOR instead of JSON.

    CBOR is shorter, and can contain bytes and NaN; it is not human-readable.

    >>> payload_of(Cbor({"angle": 12.5})).encoding
    'application/cbor'
    """

    #: The value to send.
    value: Any


class Picture:
    """A picture: rows of pixels from the top left, without padding.

    `numpy.asarray(picture)` returns its pixels, and `picture.pillow()` returns it as a Pillow image. Colours are in the
    order red, green, blue; OpenCV has blue first: `cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)`. The orientation in a
    picture's EXIF data is not applied, neither to a Pillow image (`PIL.ImageOps.exif_transpose` does so) nor to a
    received JPEG file. A PNG with 16 bits per channel is read with the upper 8 bits of each.

    >>> Picture.of_pixels(2, 1, "rgb8", bytes(6))
    Picture(2x1 rgb8)
    """

    __slots__ = ("format", "height", "pixels", "width")

    #: Width, in pixels.
    width: int
    #: Height, in pixels.
    height: int
    #: Channels of a pixel: `grey8`, `rgb8` or `rgba8`, one byte per channel.
    format: PixelFormat
    #: The pixels: `width * height` times 1, 3 or 4 bytes.
    pixels: bytes

    def __init__(self, picture: numpy.ndarray[Any, Any] | PIL.Image.Image | Picture) -> None:
        """Makes a picture from a numpy array of bytes or from a Pillow image.

        The shape of the array is height x width (grey), or height x width x 3 (RGB) or x 4 (RGBA).

        Raises `PayloadError` if the array has another type or shape, or the image more than 8 bits per channel.
        """
        size: tuple[int, int, PixelFormat, bytes]
        if isinstance(picture, Picture):
            size = (picture.width, picture.height, picture.format, picture.pixels)
        elif _is_array(picture):
            size = _pixels_of_array(picture)
        elif _is_pillow(picture):
            size = _pixels_of_pillow(picture)
        else:
            name = type(picture).__name__
            raise TypeError(f"picture must be a numpy array, a Pillow image or a rect.Picture, not {name}")
        self.width, self.height, self.format, self.pixels = size
        _rect.picture(*size)

    @classmethod
    def of_pixels(cls, width: int, height: int, format: PixelFormat, pixels: bytes) -> Picture:
        """Makes a picture from pixels of the format `grey8`, `rgb8` or `rgba8`.

        Raises `CodecError` if the number of bytes does not match the size and format.
        """
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
        """Returns the pixels as an array of bytes: height x width for `grey8`, else height x width x 3 or 4."""
        return self.__array__()

    def pillow(self) -> PIL.Image.Image:
        """Returns the picture as a Pillow image."""
        import PIL.Image

        return PIL.Image.frombytes(_MODES[self.format], (self.width, self.height), self.pixels)

    def scaled(self, width: int, height: int) -> Picture:
        """Returns the picture scaled to `width` x `height` pixels. Raises `CodecError` if that size is not possible."""
        return Picture.of_pixels(*_rect.scaled((self.width, self.height, self.format), self.pixels, (width, height)))

    def _repr_png_(self) -> bytes:
        return _rect.Codec("png").encode(*_raw_picture(self))[0]

    def __reduce__(self) -> tuple[Any, ...]:
        return reduced(self)

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


def reduced(value: Any) -> tuple[Any, ...]:
    """Returns how `pickle` and `copy` make the same object of a class with `__slots__`, in every protocol."""
    names = [name for cls in type(value).__mro__ for name in getattr(cls, "__slots__", ())]
    return _restored, (type(value), {name: getattr(value, name) for name in names if hasattr(value, name)})


def _restored(cls: type[Any], fields: dict[str, Any]) -> Any:
    """Returns the object that `reduced` has described."""
    made = object.__new__(cls)
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made


def payload_of(value: Any, codec: _rect.Codec | None = None) -> Payload:
    """Encodes a value, and compresses it if a codec is given."""
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
    """Decodes a payload by its encoding."""
    kind = _rect.encoding_kind(payload.encoding)
    if kind in ("json", "cbor"):
        return _rect.read_value(payload.bytes, payload.encoding)
    if kind == "text":
        try:
            return payload.bytes.decode()
        except UnicodeDecodeError as error:
            text = f"the payload is not valid text: {error}"
            raise PayloadError(text, "read") from None
    rest = payload.encoding.partition(";")[2] if kind == "raw" else ""
    if kind in _PICTURE_CODECS or rest.startswith("picture;"):
        return Picture.of_pixels(*_rect.read_picture(payload.bytes, payload.encoding))
    if rest.startswith("array;") or rest == "quantised":
        return _numpy_of(payload)
    return payload.bytes


def codec_of(codec: str | _rect.Codec | None) -> _rect.Codec | None:
    """Returns the codec with this name, such as `zstd:9` or `jpeg:60`."""
    if codec is None or isinstance(codec, _rect.Codec):
        return codec
    if isinstance(codec, str):
        return _rect.Codec(codec)
    raise TypeError(f"codec must be a name such as 'zstd:9' or a rect.Codec, not {type(codec).__name__}")


def _parts(value: Any) -> tuple[bytes, str]:
    if type(value) in _PLAIN:
        return _rect.write_value(value)
    if isinstance(value, str):
        try:
            return value.encode(), TEXT
        except UnicodeEncodeError as error:
            raise PayloadError(f"the value cannot be encoded as text: {error}", "write") from None
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
    """Returns the parts of a payload that the program made, if it can be sent."""
    if not isinstance(payload.bytes, bytes):
        raise TypeError(f"Payload.bytes must be bytes, not {type(payload.bytes).__name__}")
    if not isinstance(payload.encoding, str):
        raise TypeError(f"Payload.encoding must be a str, not {type(payload.encoding).__name__}")
    try:
        payload.encoding.encode()
    except UnicodeEncodeError as error:
        raise PayloadError(f"the encoding is not valid UTF-8: {error}", "encoding") from None
    return payload.bytes, payload.encoding


def _raw_picture(picture: Picture) -> tuple[bytes, str]:
    return picture.pixels, _rect.picture_encoding(picture.width, picture.height, picture.format, picture.pixels)


def _raw_array(array: numpy.ndarray[Any, Any]) -> tuple[bytes, str]:
    import numpy

    kind = f"{array.dtype.kind}{array.dtype.itemsize * 8}"
    if kind not in _ELEMENTS:
        # numpy counts bytes and this library bits: "f4" is f32.
        text = f"an array of {array.dtype} cannot be sent; possible types: {', '.join(_ELEMENTS)}"
        raise PayloadError(f"{text}. {_advice(array)}", "write")
    _check_mask(array)
    little = numpy.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    numbers = little.tobytes()
    return numbers, _rect.array_encoding(kind, list(array.shape), numbers)


def _check_mask(array: numpy.ndarray[Any, Any]) -> None:
    """Raises `PayloadError` if items of a masked array are masked: they would be sent as if they were not."""
    import numpy

    if isinstance(array, numpy.ma.MaskedArray) and numpy.ma.is_masked(array):
        text = "items of the array are masked: publish array.filled(value), or array.tolist(), in which they are None"
        raise PayloadError(text, "write")


def _advice(array: numpy.ndarray[Any, Any]) -> str:
    """Returns how to send an array whose type of elements the encoding for arrays does not have."""
    if array.dtype.names is not None or array.dtype.kind == "M":
        return "Publish it within a dict or list, as JSON: {'records': array}"
    if array.dtype.kind == "m":
        return "Publish numbers: array / numpy.timedelta64(1, 's')"
    if array.dtype.kind in "biuf":
        return "Convert it with array.astype(...), or publish array.tolist() as JSON"
    return "Publish array.tolist()"


def _numpy_of(payload: Payload) -> numpy.ndarray[Any, Any]:
    element, shape, numbers = _rect.read_array(payload.bytes, payload.encoding)
    try:
        import numpy
    except ImportError:
        raise PayloadError("numpy is needed to decode an array: `pip install numpy`") from None
    dtype = numpy.dtype(f"<{element[0]}{int(element[1:]) // 8}")
    return numpy.frombuffer(numbers, dtype).reshape(shape)


def _pixels_of_array(array: numpy.ndarray[Any, Any]) -> tuple[int, int, PixelFormat, bytes]:
    channels = 1 if array.ndim == 2 else array.shape[-1]
    formats: dict[int, PixelFormat] = {count: name for name, count in _CHANNELS.items()}
    is_pixels, dtype = array.dtype == "uint8", array.dtype
    if not is_pixels or array.ndim not in (2, 3) or channels not in formats:
        found = f"{dtype}, {'x'.join(map(str, array.shape))}"
        text = f"a picture must be an array of uint8, height x width or height x width x 1, 3 or 4; this one is {found}"
        if dtype.kind == "f":
            text += ". If its values are 0 to 1, convert it with (array * 255).astype('uint8')"
        elif not is_pixels:
            text += ". Publish it as an array, which keeps all bits, or reduce it to 8 bits"
        raise PayloadError(text, "write")
    _check_mask(array)
    return int(array.shape[1]), int(array.shape[0]), formats[channels], array.tobytes()


def _pixels_of_pillow(image: PIL.Image.Image) -> tuple[int, int, PixelFormat, bytes]:
    if image.mode.startswith("I") or image.mode == "F":
        # Pillow would cut off all values above 255.
        text = (
            f"a picture has 8 bits per channel, and this one, of the mode {image.mode}, more: publish "
            "numpy.asarray(image), which keeps all bits, or reduce it to the mode L with the scale that it needs"
        )
        raise PayloadError(text, "write")
    modes: dict[str, PixelFormat] = {mode: name for name, mode in _MODES.items()}
    if image.mode not in modes:
        image = image.convert("RGBA" if "transparency" in image.info or "A" in image.mode else "RGB")
    return image.width, image.height, modes[image.mode], image.tobytes()


def _is_array(value: Any) -> TypeGuard[numpy.ndarray[Any, Any]]:
    numpy = sys.modules.get("numpy")
    return numpy is not None and isinstance(value, numpy.ndarray)


def _is_pillow(value: Any) -> TypeGuard[PIL.Image.Image]:
    image = sys.modules.get("PIL.Image")
    return image is not None and isinstance(value, image.Image)
