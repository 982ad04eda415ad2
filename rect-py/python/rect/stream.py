"""Defines `StreamSender`, which sends frames, and `Watcher`, which receives them. Their drivers are in the core."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import zenoh

from rect import _rect, advice
from rect._zenoh import zenoh_error
from rect.deadline import Deadline
from rect.errors import OptionError, PayloadError, TimedOut
from rect.executor import Executor
from rect.receive_queue import Ended, ReceiveQueue
from rect.values import JSON, Payload, Picture, payload_of

if TYPE_CHECKING:
    from rect.session import Session


class StreamSender:
    """Sends the frames of a stream. Returned by `Robot.stream`.

    The stream ends when it or the robot is closed, or when it is garbage-collected.
    """

    def __init__(
        self,
        session: Session,
        topic: str,
        mode: str,
        codec: _rect.Codec | None,
        lossy_format: str,
        urgency: str,
        **options: Any,
    ) -> None:
        if lossy_format not in ("jpeg", "webp"):
            raise OptionError("lossy_format", lossy_format, 'it must be "jpeg" or "webp"')
        self._session = session
        self._codec = codec
        self._sends_pictures = mode in ("adaptive", "video")
        self._is_video = mode == "video"
        webp = lossy_format == "webp"
        self._core = _rect.StreamPublish(
            session.key_space, topic, urgency, mode, random.getrandbits(16), webp=webp, **options
        )
        self._sending = threading.Lock()
        self._executor = Executor(session, self._core.driver())
        self._executor.start("rect stream")
        self._executor.leave_with(self)

    def send(self, frame: Any) -> int:
        """Sends a frame to the receivers that are due for one. Does not wait for the link.

        Returns the number of groups of receivers to which the frame was sent: 0 to 2. A picture (numpy, Pillow or
        `Picture`) of an adaptive stream is sent at the size and quality that the link allows, and that of a video
        stream as video. Any other frame is sent unchanged, or compressed by the codec of the stream; an array that is
        not a picture is an error in a video stream. A frame is dropped if a slow link cannot accept it, or if the robot
        is closed meanwhile.

        Raises `PayloadError`, `CodecError` and `Closed`.
        """
        self._session.check()
        picture = _picture(frame, self._is_video) if self._sends_pictures and self._codec is None else None
        # One frame at a time, so that frames are sent in the order of their numbers.
        with self._sending:
            if self._session.is_closed:
                return 0
            if picture is not None:
                size = (picture.width, picture.height, picture.format)
                jobs = self._core.offer_picture(picture.width, picture.height)
                for job in jobs:
                    self._put(job, *self._core.encode_picture(job, size, picture.pixels))
                return len(jobs)
            raw = payload_of(frame) if self._codec is None else None
            jobs = self._core.offer(len(raw.bytes) if raw is not None else 1)
            for job in jobs:
                payload = raw or payload_of(frame, self._codec)
                self._put(job, payload.bytes, payload.encoding)
        return len(jobs)

    def send_with(self, pixels: int, encode: Callable[[int | None, float | None], Any]) -> int:
        """Sends a frame of `pixels` pixels that the program encodes itself.

        Calls `encode(quality, scale)` once for each group of receivers that is due for a frame, and not at all if there
        is none. `quality` is 1 to 100, or `None` for lossless; `scale` is the factor for width and height, at most 1.
        Both are `None` if the stream is not adaptive. `encode` returns the frame, for example as a `Payload`. Returns
        the number of groups to which the frame was sent: 0 to 2.

        Raises `PayloadError` and `Closed`.
        """
        self._session.check()
        with self._sending:
            if self._session.is_closed:
                return 0
            jobs = self._core.offer(pixels)
            for job in jobs:
                payload = payload_of(encode(job.quality, job.scale))
                self._put(job, payload.bytes, payload.encoding)
        return len(jobs)

    @property
    def status(self) -> dict[str, Any]:
        """State of the stream: what is sent (`groups`), what arrives (`receivers`), why (docs/concepts/streams.md)."""
        status: dict[str, Any] = _rect.read_value(self._core.status(), JSON)
        return status

    def close(self) -> None:
        """Ends the stream."""
        self._executor.end()

    def __enter__(self) -> StreamSender:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"StreamSender({self._core.key})"

    def _put(self, job: _rect.Job, frame: bytes, encoding: str) -> None:
        step = self._core.frame(job, frame, encoding)
        try:
            self._executor.act(step)
        except zenoh.ZError as error:
            if not self._session.is_closed:
                raise zenoh_error("cannot send the frame", error) from error


@dataclass(frozen=True)
class Frame:
    """A frame of a stream."""

    #: The payload: bytes with an encoding. A frame of a video is decoded: the payload is the raw picture.
    payload: Payload
    #: Sequence number. It restarts when the sender does, and when this robot is moved to another group of receivers.
    number: int
    #: Age of the frame on arrival, in seconds. If the offset of the clocks is unknown, the delay relative to the
    #: fastest frame of the last minute. `None` if the sender does not use RECT.
    age: float | None
    #: Number of frames directly before this one that a link dropped, or that the program was too slow to read.
    skipped: int
    #: Number of these that did not arrive.
    lost: int
    #: Length of the frame as it was sent, in bytes.
    sent_bytes: int

    @property
    def value(self) -> Any:
        """The decoded payload; see `Message.value`."""
        return self.payload.value

    def _repr_png_(self) -> bytes | None:
        value = self.value
        return value._repr_png_() if isinstance(value, Picture) else None


class Watcher:
    """Receives the frames of a stream. Returned by `Robot.watch`.

    Iterating waits for one frame after another, and skips outdated ones. It ends when the watcher or the robot is
    closed.
    """

    _HANDLE = "watcher"

    def __init__(self, session: Session, stream: str, capacity: int, when_full: str, decode: bool) -> None:
        self._session = session
        self._name = stream
        #: Ordinal, number of lost frames until then, number, age, bytes and encoding of a frame.
        self._queue: ReceiveQueue[tuple[int, int, int, float | None, bytes, str]] = ReceiveQueue(capacity, when_full)
        self._core = _rect.StreamWatch(session.key_space, stream, random.getrandbits(16))
        if not decode:
            self._core.leave_undecoded()
        self._reader = self._core.reader()
        self._executor = Executor(session, self._core.driver(), self._queue.queue, queue=self._queue)
        self._executor.start("rect watch")
        self._executor.leave_with(self)
        advice.on_stream(session, stream)

    def next(self, timeout: float | None = None) -> Frame:
        """Waits for a frame that was not returned yet and returns it. By default that is the newest frame.

        `timeout` is in seconds; `None`, the default, waits without limit.

        Raises `TimedOut` if no frame arrives in time, and `Closed` if the watcher or the robot is closed.
        """
        try:
            return self._next(timeout)
        except Ended:
            raise self._session.closed_error(self._HANDLE) from None
        except TimeoutError:
            raise TimedOut(f"frame of {self._name}", timeout or 0) from None

    def __iter__(self) -> Iterator[Frame]:
        return self

    def __next__(self) -> Frame:
        try:
            return self._next(None)
        except Ended:
            raise StopIteration from None

    async def next_async(self, timeout: float | None = None) -> Frame:
        """Does the same as `next`, for asyncio. Raises `Ended` and `TimeoutError`."""
        deadline = Deadline(timeout)
        while True:
            frame = self._read(await self._queue.pop_async(deadline.remaining()))
            if frame is not None:
                return frame

    def ask_for_key_frame(self) -> None:
        """Asks the sender of a video for a key frame, with the next frame that arrives.

        This is for a program that decodes the video itself, and has dropped frames.
        """
        self._core.ask_for_key()

    @property
    def dropped(self) -> int:
        """Number of frames dropped because the receive queue was full: by default, those that newer ones replaced."""
        return self._queue.dropped

    @property
    def round_trip(self) -> float | None:
        """Round trip of a small message to the sender, in seconds. `None` until it is measured."""
        return self._core.round_trip()

    def close(self) -> None:
        """Stops receiving the stream."""
        self._executor.end()

    def __enter__(self) -> Watcher:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Watch({self._name})"

    def _next(self, timeout: float | None) -> Frame:
        """Waits for a frame that can be shown. Raises `Ended` and `TimeoutError`."""
        deadline = Deadline(timeout)
        while True:
            frame = self._read(self._queue.pop(deadline.remaining()))
            if frame is not None:
                return frame

    def _read(self, received: tuple[int, int, int, float | None, bytes, str]) -> Frame | None:
        read = self._reader.read(received)
        if read is None:
            return None
        (payload, encoding), skipped, lost, sent_bytes = read
        _, _, number, age, _, _ = received
        return Frame(Payload(payload, encoding), number, age, skipped, lost, sent_bytes)


def _picture(frame: Any, is_video: bool) -> Picture | None:
    """Converts the frame to a picture, if it is one. An array that is none is an error only in a video."""
    if isinstance(frame, (str, bytes, dict, list, tuple, int, float, Payload)) or frame is None:
        return None
    try:
        return Picture(frame)
    except TypeError:
        return None
    except PayloadError:
        if is_video:
            raise
        return None
