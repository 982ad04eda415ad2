"""Owns streams as a program has them: `Stream` sends, `Watch` receives. What they do, the core decides."""

from __future__ import annotations

import logging
import random
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import zenoh

from rect import _rect
from rect._zenoh import direct, payload_bytes, qos, refused
from rect.errors import OptionError, PayloadError, TimedOut
from rect.inbox import Ended, Inbox
from rect.subscriber import Declared
from rect.values import JSON, Payload, Picture, payload_of

if TYPE_CHECKING:
    from rect.session import Session

_LOG = logging.getLogger("rect")
#: The key of a group that is left is listened to for so long still: what is on its way comes.
_LINGER_S = 0.3
_PATIENCE_S = 3.0
_GROUPS = (0, 1)


class Stream:
    """A stream that this program sends. It ends when it is closed, or the robot is, or nobody has it any more."""

    def __init__(
        self,
        session: Session,
        topic: str,
        mode: str,
        codec: _rect.Codec | None,
        photographs: str,
        urgency: str,
        **options: float | None,
    ) -> None:
        if photographs not in ("jpeg", "webp"):
            raise OptionError("photographs", photographs, 'it is "jpeg" or "webp"')
        self._session = session
        self._codec = codec
        self._is_adaptive = mode == "adaptive"
        webp = photographs == "webp"
        self._core = _rect.StreamSender(mode, random.getrandbits(16), _rect.now_ms(), webp=webp, **options)
        self._sending = threading.Lock()
        self._declared = Declared(session)
        place, me = session.place, session.place.robot
        self._notice_key = place.notice(me, topic)
        try:
            treated = qos(_rect.qos_of_frames(urgency))
            self._publishers = [self._frames(place.frames(me, topic, group), group, treated) for group in _GROUPS]
            heard = session.zenoh.declare_subscriber(place.feedbacks(topic), direct(self._on_feedback))
            self._declared.add(heard)
            asked = direct(_answerer(self._core, self._notice_key))
            self._declared.add(session.zenoh.declare_queryable(self._notice_key, asked, complete=True))
        except zenoh.ZError as error:
            self._declared.end()
            raise refused("the stream is refused", error) from None
        session.streams.add(self)
        weakref.finalize(self, self._declared.leave).atexit = False

    def send(self, frame: Any) -> int:
        """Sends a frame, if anyone wants one now; to how many groups it went. Does not wait for the link.

        A picture (numpy, Pillow or `Picture`) of an adaptive stream goes at the size and quality that get through; all
        else goes as it is, by the stream's codec if it has one.

        A frame during which the robot is closed is dropped, like one that a slow link has no room for.

        Raises `PayloadError`, `CodecError`, `Closed`.
        """
        self._session.check()
        picture = _picture(frame) if self._is_adaptive and self._codec is None else None
        # One frame at a time: they go out in the order of their numbers.
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
        """There is a frame of so many pixels: `encode(quality, scale)` makes it, once for each group that gets one
        now, and is not called where nobody does. `quality` 1 to 100, `None`: lossless; `scale` of width and height;
        both `None` where the program's own choice counts. To how many it went."""
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
        """What goes out (`groups`), what gets through (`receivers`), and why it is as it is (docs/streams.md)."""
        status: dict[str, Any] = _rect.read_value(self._core.status(), JSON)
        return status

    def close(self) -> None:
        """Ends it."""
        self._declared.end()

    def finish(self, timeout: float) -> None:
        """Waits for who is sending a frame: a thread that Python's end finds in Zenoh ends the process."""
        if self._sending.acquire(timeout=timeout):
            self._sending.release()

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Stream({self._notice_key})"

    def _frames(self, key: str, group: int, treated: dict[str, Any]) -> zenoh.Publisher:
        """What puts a group's frames, and knows whether anyone wants them."""
        core = self._core
        publisher: zenoh.Publisher = self._session.zenoh.declare_publisher(key, **treated)
        self._declared.add(publisher)
        listener = publisher.declare_matching_listener(
            direct(lambda status: core.on_subscribers(group, status.matching))
        )
        self._declared.add(listener)
        # A `MatchingStatus`, whatever the stubs of eclipse-zenoh 1.10 say.
        status: Any = publisher.matching_status
        core.on_subscribers(group, status.matching)
        return publisher

    def _put(self, job: _rect.Job, frame: bytes, encoding: str) -> None:
        attachment = self._core.on_encoded(job, len(frame))
        try:
            self._publishers[job.group].put(frame, encoding=encoding, attachment=attachment)
        except zenoh.ZError as error:
            if not self._session.is_closed:
                raise refused("the frame is not sent", error) from None

    @property
    def _on_feedback(self) -> Callable[[zenoh.Sample], None]:
        # Not of this object, so that it ends when nobody has it.
        core, session, notice_key = self._core, self._session, self._notice_key

        def on_feedback(sample: zenoh.Sample) -> None:
            core.on_feedback(session.place, str(sample.key_expr), payload_bytes(sample.payload))
            notice = core.poll_notice()
            if notice is not None:
                # Rare, and reliable: it may have to wait for room, which Zenoh's thread may not.
                session.start("rect notice", lambda: _tell(session, notice_key, notice))

        return on_feedback


@dataclass(frozen=True)
class Frame:
    """A frame of a stream."""

    #: What it is, as bytes with an encoding.
    payload: Payload
    #: Its number. The sender numbers anew when it starts, and when this robot gets other frames than before.
    number: int
    #: How old it was when it came, in seconds; until the sender has told its time, how much older than the fastest of
    #: the last minute. `None`: another program's, which does not tell.
    age: float | None
    #: So many before it were not seen: the link dropped them, or this program was not there to take them.
    skipped: int

    @property
    def value(self) -> Any:
        """What it says; see `Message.value`."""
        return self.payload.value

    def _repr_png_(self) -> bytes | None:
        value = self.value
        return value._repr_png_() if isinstance(value, Picture) else None


class Watch:
    """A stream that this program watches: an iterator that waits for the newest frame that was not taken yet."""

    dropped = 0

    def __init__(self, session: Session, robot: str, topic: str, capacity: int, when_full: str) -> None:
        self._session = session
        self._name = f"{robot}/{topic}"
        self._listening = _Listening(session, robot, topic, capacity, when_full)
        self._last: int | None = None
        weakref.finalize(self, self._listening.leave).atexit = False

    def next(self, timeout: float | None = None) -> Frame:
        """The newest frame, once there is one. Raises `TimedOut` (seconds), `Closed`."""
        try:
            return self.counted(self._listening.inbox.pop(timeout))
        except Ended:
            raise self._session.closed_error() from None
        except TimeoutError:
            raise TimedOut(f"frame of {self._name}", timeout or 0) from None

    def __iter__(self) -> Iterator[Frame]:
        return self

    def __next__(self) -> Frame:
        try:
            return self.counted(self._listening.inbox.pop())
        except Ended:
            raise StopIteration from None

    async def next_async(self, timeout: float | None = None) -> Frame:
        """The same for asyncio. Raises `Ended`, `TimeoutError`."""
        return self.counted(await self._listening.inbox.pop_async(timeout))

    @property
    def round_trip(self) -> float | None:
        """What a small message takes to the sender and back, in seconds, once it has answered one."""
        return self._listening.core.round_trip()

    def close(self) -> None:
        """Ends it."""
        self._listening.stop()

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


class _Listening:
    """The thread behind a `Watch`."""

    def __init__(self, session: Session, robot: str, topic: str, capacity: int, when_full: str) -> None:
        place = session.place
        self.inbox: Inbox[tuple[int, Frame]] = Inbox(capacity, when_full)
        self.core = _rect.StreamReceiver(place.robot, random.getrandbits(16))
        self._session = session
        self._keys = [place.frames(robot, topic, group) for group in _GROUPS]
        self._notice_key = place.notice(robot, topic)
        self._hears: list[zenoh.Subscriber[None] | None] = [None, None]
        self._group: tuple[int, float] | None = None
        #: Frames that were sent since the first that came.
        self._ordinal = 0
        self._lock = threading.Lock()
        self._is_ended = False
        #: The sender has said something, or it ends.
        self._told = threading.Event()
        self._declared = Declared(session, self.inbox)
        treated = qos(_rect.qos("urgent"))
        treated["congestion_control"] = zenoh.CongestionControl.DROP
        try:
            self._says = session.zenoh.declare_publisher(place.feedback(robot, topic), **treated)
            self._declared.add(self._says)
            self._declared.add(session.zenoh.declare_subscriber(self._notice_key, direct(self._on_notice)))
        except zenoh.ZError as error:
            self._declared.end()
            raise refused("the stream's notices are refused", error) from None
        session.endings.append(self._told.set)
        session.start("rect watch", self._run)

    def stop(self) -> None:
        self._end()
        self._declared.end()

    def leave(self) -> None:
        self._end()
        self._declared.leave()

    def _end(self) -> None:
        self._is_ended = True
        self._told.set()

    def _run(self) -> None:
        try:
            while True:
                self._told.clear()
                if self._is_ended or self._session.is_closed:
                    break
                self._told.wait(self._poll())
        except zenoh.ZError as error:
            _LOG.debug("%s: %s", self._notice_key, error)
        finally:
            self.inbox.close()

    def _poll(self) -> float:
        """Does what is due; in how many seconds there may be more to do."""
        group = self.core.poll_group()
        asks, says = self.core.poll_question(), self.core.poll_feedback()
        if asks:
            self._ask()
        if group is not None:
            self._listen(group)
        if says is not None:
            self._says.put(says)
        poll_in: float = self.core.poll_in()
        if self._group is not None and self._hears[1 - self._group[0]] is not None:
            return min(poll_in, max(self._group[1] + _LINGER_S - time.monotonic(), 0))
        return poll_in

    def _ask(self) -> None:
        core, told, asked = self.core, self._told, time.monotonic()

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                core.on_answer(payload_bytes(reply.ok.payload), time.monotonic() - asked)
                told.set()

        treated = qos(_rect.qos("urgent"))
        del treated["congestion_control"]
        self._session.zenoh.get(self._notice_key, direct(on_reply), timeout=_PATIENCE_S, **treated)

    def _listen(self, group: int) -> None:
        """Listens to a group's key; the other's is left a little later."""
        if self._hears[group] is None:
            heard = self._session.zenoh.declare_subscriber(self._keys[group], direct(self._on_frame))
            self._hears[group] = heard
            self._declared.add(heard)
        if self._group is None or self._group[0] != group:
            self._group = (group, time.monotonic())
            return
        other = self._hears[1 - group]
        if other is not None and time.monotonic() - self._group[1] >= _LINGER_S:
            self._hears[1 - group] = None
            other.undeclare()

    def _on_notice(self, sample: zenoh.Sample) -> None:
        self.core.on_notice(payload_bytes(sample.payload))
        self._told.set()

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
        self.inbox.push((ordinal, Frame(Payload(frame, str(sample.encoding)), number, age, skipped)))


def _answerer(core: _rect.StreamSender, key: str) -> Callable[[zenoh.Query], None]:
    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(key, core.notice(), encoding=JSON)

    return answer


def _tell(session: Session, key: str, notice: bytes) -> None:
    """Who is to listen elsewhere is told, reliably."""
    try:
        session.zenoh.put(key, notice, encoding=JSON, congestion_control=zenoh.CongestionControl.BLOCK)
    except zenoh.ZError as error:
        _LOG.debug("%s is not told any more: %s", key, error)


def _picture(frame: Any) -> Picture | None:
    """The frame as a picture, if it is one."""
    if isinstance(frame, (str, bytes, dict, list, tuple, int, float, Payload)) or frame is None:
        return None
    try:
        return Picture(frame)
    except (TypeError, PayloadError):
        return None
