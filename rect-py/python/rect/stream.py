"""Defines `Stream`, which sends frames, and `Watch`, which receives them. The core makes their decisions."""

from __future__ import annotations

import logging
import random
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import zenoh

from rect import _rect
from rect._zenoh import direct, payload_bytes, qos, zenoh_error
from rect.errors import OptionError, PayloadError, TimedOut
from rect.receive_queue import Ended, ReceiveQueue
from rect.subscriber import Declared
from rect.values import JSON, Payload, Picture, payload_of

if TYPE_CHECKING:
    from rect.session import Session

_LOG = logging.getLogger("rect")
#: After a change of groups, the subscription to the old one stays for this time, in seconds, so that frames in flight
#: still arrive.
_LINGER_S = 0.3
_TIMEOUT_S = 3.0
_GROUPS = (0, 1)


class Stream:
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
        **options: float | None,
    ) -> None:
        if lossy_format not in ("jpeg", "webp"):
            raise OptionError("lossy_format", lossy_format, 'it must be "jpeg" or "webp"')
        self._session = session
        self._codec = codec
        self._is_adaptive = mode == "adaptive"
        webp = lossy_format == "webp"
        self._core = _rect.StreamSender(mode, random.getrandbits(16), _rect.now_ms(), webp=webp, **options)
        self._sending = threading.Lock()
        self._declared = Declared(session)
        key_space, me = session.key_space, session.key_space.robot
        self._notice_key = key_space.notice(me, topic)
        try:
            qos_fields = qos(_rect.stream_qos(urgency))
            self._publishers = [
                self._frames(key_space.frames(me, topic, group), group, qos_fields) for group in _GROUPS
            ]
            subscriber = session.zenoh.declare_subscriber(key_space.feedbacks(topic), direct(self._on_feedback))
            self._declared.add(subscriber)
            on_query = direct(_reply_with_notice(self._core, self._notice_key))
            self._declared.add(session.zenoh.declare_queryable(self._notice_key, on_query, complete=True))
        except zenoh.ZError as error:
            self._declared.end()
            raise zenoh_error("cannot declare the stream", error) from None
        session.streams.add(self)
        self._declared.leave_with(self)

    def send(self, frame: Any) -> int:
        """Sends a frame to the receivers that are due for one. Does not wait for the link.

        Returns the number of groups of receivers to which the frame was sent: 0 to 2. A picture (numpy, Pillow or
        `Picture`) of an adaptive stream is sent at the size and quality that the link allows. Any other frame is sent
        unchanged, or compressed by the codec of the stream. A frame is dropped if a slow link cannot accept it, or if
        the robot is closed meanwhile.

        Raises `PayloadError`, `CodecError` and `Closed`.
        """
        self._session.check()
        picture = _picture(frame) if self._is_adaptive and self._codec is None else None
        # One frame at a time, so that frames are sent in the order of their numbers.
        with self._sending:
            if self._session.is_closed:
                return 0
            if picture is not None:
                size = (picture.width, picture.height, picture.format)
                jobs = self._core.offer(picture.width * picture.height)
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
        self._declared.end()

    def finish(self, timeout: float) -> None:
        """Waits until no frame is being sent, for at most `timeout` seconds.

        Python aborts on exit if a thread is inside Zenoh.
        """
        if self._sending.acquire(timeout=timeout):
            self._sending.release()

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Stream({self._notice_key})"

    def _frames(self, key: str, group: int, qos_fields: dict[str, Any]) -> zenoh.Publisher:
        """Declares the publisher of a group's frames, and watches whether the group has subscribers."""
        core = self._core
        publisher: zenoh.Publisher = self._session.zenoh.declare_publisher(key, **qos_fields)
        self._declared.add(publisher)
        listener = publisher.declare_matching_listener(
            direct(lambda status: core.on_subscribers(group, status.matching))
        )
        self._declared.add(listener)
        # This is a `MatchingStatus`; the stubs of eclipse-zenoh 1.10 are wrong here.
        status: Any = publisher.matching_status
        core.on_subscribers(group, status.matching)
        return publisher

    def _put(self, job: _rect.Job, frame: bytes, encoding: str) -> None:
        attachment = self._core.on_encoded(job, len(frame))
        try:
            self._publishers[job.group].put(frame, encoding=encoding, attachment=attachment)
        except zenoh.ZError as error:
            if not self._session.is_closed:
                raise zenoh_error("cannot send the frame", error) from None

    @property
    def _on_feedback(self) -> Callable[[zenoh.Sample], None]:
        # The function does not refer to `self`, so that the stream can be garbage-collected.
        core, session, notice_key = self._core, self._session, self._notice_key

        def on_feedback(sample: zenoh.Sample) -> None:
            core.on_feedback(session.key_space, str(sample.key_expr), payload_bytes(sample.payload))
            notice = core.poll_notice()
            if notice is not None:
                # Notices are rare and reliable. Sending one may block, which a Zenoh thread must not.
                session.start("rect notice", lambda: _publish_notice(session, notice_key, notice))

        return on_feedback


@dataclass(frozen=True)
class Frame:
    """A frame of a stream."""

    #: The payload: bytes with an encoding.
    payload: Payload
    #: Sequence number. It restarts when the sender does, and when this robot is moved to another group of receivers.
    number: int
    #: Age of the frame on arrival, in seconds. If the offset of the clocks is unknown, the delay relative to the
    #: fastest frame of the last minute. `None` if the sender does not use RECT.
    age: float | None
    #: Number of frames directly before this one that a link dropped, or that the program was too slow to read.
    skipped: int

    @property
    def value(self) -> Any:
        """The decoded payload; see `Message.value`."""
        return self.payload.value

    def _repr_png_(self) -> bytes | None:
        value = self.value
        return value._repr_png_() if isinstance(value, Picture) else None


class Watch:
    """Receives the frames of a stream. Returned by `Robot.watch`.

    Iterating waits for one frame after another and skips outdated ones; it ends when the watch or the robot is closed.
    """

    _HANDLE = "watch"

    def __init__(self, session: Session, robot: str, topic: str, capacity: int, when_full: str) -> None:
        self._session = session
        self._name = f"{robot}/{topic}"
        self._receiver = _FrameReceiver(session, robot, topic, capacity, when_full)
        self._last: int | None = None
        self._receiver.leave_with(self)

    def next(self, timeout: float | None = None) -> Frame:
        """Waits for a frame that was not returned yet and returns it. By default that is the newest frame.

        `timeout` is in seconds; `None`, the default, waits without limit.

        Raises `TimedOut` if no frame arrives in time, and `Closed` if the watch or the robot is closed.
        """
        try:
            return self.counted(self._receiver.queue.pop(timeout))
        except Ended:
            raise self._session.closed_error(self._HANDLE) from None
        except TimeoutError:
            raise TimedOut(f"frame of {self._name}", timeout or 0) from None

    def __iter__(self) -> Iterator[Frame]:
        return self

    def __next__(self) -> Frame:
        try:
            return self.counted(self._receiver.queue.pop())
        except Ended:
            raise StopIteration from None

    async def next_async(self, timeout: float | None = None) -> Frame:
        """Does the same as `next`, for asyncio. Raises `Ended` and `TimeoutError`."""
        return self.counted(await self._receiver.queue.pop_async(timeout))

    @property
    def dropped(self) -> int:
        """Number of frames dropped because the receive queue was full: by default, those that newer ones replaced."""
        return self._receiver.queue.dropped

    @property
    def round_trip(self) -> float | None:
        """Round trip of a small message to the sender, in seconds. `None` until it is measured."""
        return self._receiver.core.round_trip()

    def close(self) -> None:
        """Stops receiving the stream."""
        self._receiver.stop()

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Watch({self._name})"

    def counted(self, seen: tuple[int, Frame]) -> Frame:
        ordinal, frame = seen
        skipped = 0 if self._last is None else max(ordinal - self._last - 1, 0)
        self._last = ordinal
        return Frame(frame.payload, frame.number, frame.age, skipped)


class _FrameReceiver:
    """The subscriptions of a `Watch`, and the thread that sends its feedback."""

    def __init__(self, session: Session, robot: str, topic: str, capacity: int, when_full: str) -> None:
        key_space = session.key_space
        self.queue: ReceiveQueue[tuple[int, Frame]] = ReceiveQueue(capacity, when_full)
        self.core = _rect.StreamReceiver(key_space.robot, random.getrandbits(16))
        self._session = session
        self._keys = [key_space.frames(robot, topic, group) for group in _GROUPS]
        self._notice_key = key_space.notice(robot, topic)
        self._subscribers: list[zenoh.Subscriber[None] | None] = [None, None]
        self._group: tuple[int, float] | None = None
        #: Number of frames sent since the first one that arrived.
        self._ordinal = 0
        self._lock = threading.Lock()
        self._is_ended = False
        #: Set when the sender has published a notice, or when this ends.
        self._wake = threading.Event()
        self._declared = Declared(session, self.queue)
        qos_fields = qos(_rect.qos("urgent"))
        qos_fields["congestion_control"] = zenoh.CongestionControl.DROP
        try:
            self._feedback = session.zenoh.declare_publisher(key_space.feedback(robot, topic), **qos_fields)
            self._declared.add(self._feedback)
            self._declared.add(session.zenoh.declare_subscriber(self._notice_key, direct(self._on_notice)))
        except zenoh.ZError as error:
            self._declared.end()
            raise zenoh_error("cannot subscribe to the notices of the stream", error) from None
        session.close_callbacks.append(self._wake.set)
        session.start("rect watch", self._run)

    def stop(self) -> None:
        self._end()
        self._declared.end()

    def leave_with(self, handle: object) -> None:
        """Ends this receiver without blocking when `handle` is garbage-collected without having been closed."""
        self._declared.leave_with(handle, self._leave)

    def _leave(self) -> None:
        self._end()
        self._declared.leave()

    def _end(self) -> None:
        self._is_ended = True
        self._wake.set()

    def _run(self) -> None:
        try:
            while True:
                self._wake.clear()
                if self._is_ended or self._session.is_closed:
                    break
                self._wake.wait(self._poll())
        except zenoh.ZError as error:
            _LOG.debug("%s: %s", self._notice_key, error)
        finally:
            self.queue.close()

    def _poll(self) -> float:
        """Does what is due now. Returns the time until the next call, in seconds."""
        group = self.core.poll_group()
        is_query_due, feedback = self.core.poll_question(), self.core.poll_feedback()
        if is_query_due:
            self._query_notice()
        if group is not None:
            self._subscribe(group)
        if feedback is not None:
            self._feedback.put(feedback)
        poll_in: float = self.core.poll_in()
        if self._group is not None and self._subscribers[1 - self._group[0]] is not None:
            return min(poll_in, max(self._group[1] + _LINGER_S - time.monotonic(), 0))
        return poll_in

    def _query_notice(self) -> None:
        core, wake, sent_at = self.core, self._wake, time.monotonic()

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                core.on_answer(payload_bytes(reply.ok.payload), time.monotonic() - sent_at)
                wake.set()

        qos_fields = qos(_rect.qos("urgent"))
        del qos_fields["congestion_control"]
        self._session.zenoh.get(self._notice_key, direct(on_reply), timeout=_TIMEOUT_S, **qos_fields)

    def _subscribe(self, group: int) -> None:
        """Subscribes to the frames of a group; the other group is unsubscribed a little later."""
        if self._subscribers[group] is None:
            subscriber = self._session.zenoh.declare_subscriber(self._keys[group], direct(self._on_frame))
            self._subscribers[group] = subscriber
            self._declared.add(subscriber)
        if self._group is None or self._group[0] != group:
            self._group = (group, time.monotonic())
            return
        other = self._subscribers[1 - group]
        if other is not None and time.monotonic() - self._group[1] >= _LINGER_S:
            self._subscribers[1 - group] = None
            other.undeclare()

    def _on_notice(self, sample: zenoh.Sample) -> None:
        self.core.on_notice(payload_bytes(sample.payload))
        self._wake.set()

    def _on_frame(self, sample: zenoh.Sample) -> None:
        attachment = sample.attachment
        frame = payload_bytes(sample.payload)
        with self._lock:
            seen = self.core.on_frame(None if attachment is None else attachment.to_bytes(), len(frame))
            if seen is None:
                return
            number, age, skipped = seen
            self._ordinal += 1 + skipped
            ordinal = self._ordinal
        self.queue.push((ordinal, Frame(Payload(frame, str(sample.encoding)), number, age, skipped)))


def _reply_with_notice(core: _rect.StreamSender, key: str) -> Callable[[zenoh.Query], None]:
    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(key, core.notice(), encoding=JSON)

    return answer


def _publish_notice(session: Session, key: str, notice: bytes) -> None:
    """Publishes a notice reliably: it tells receivers which group they belong to."""
    try:
        session.zenoh.put(key, notice, encoding=JSON, congestion_control=zenoh.CongestionControl.BLOCK)
    except zenoh.ZError as error:
        _LOG.debug("cannot publish the notice %s: %s", key, error)


def _picture(frame: Any) -> Picture | None:
    """Converts the frame to a picture, if it is one."""
    if isinstance(frame, (str, bytes, dict, list, tuple, int, float, Payload)) or frame is None:
        return None
    try:
        return Picture(frame)
    except (TypeError, PayloadError):
        return None
