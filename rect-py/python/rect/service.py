"""Serves requests: receives those for one topic, calls the handler, and sends its replies."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import logging
import threading
import time
import types
import typing
from collections.abc import Callable, Generator
from typing import TYPE_CHECKING, Any, Generic, Optional

import zenoh

from rect import _rect
from rect._zenoh import direct, zenoh_error
from rect.advice import on_problem
from rect.declared import Declared
from rect.errors import Closed, CodecError, MismatchError, PayloadError, RectError
from rect.executor import Executor
from rect.message import UNREAD
from rect.receive_queue import Ended, ReceiveQueue
from rect.typed import Converter, T, converter_of
from rect.values import Payload, payload_of

if TYPE_CHECKING:
    from rect.session import Session

#: An item of the queue: the query, its requester, the payload, and the permission to carry it out, if needed.
Admitted = tuple[zenoh.Query, _rect.Requester, bytes, str, Optional[_rect.Execution]]

_LOG = logging.getLogger("rect")


class Refusal(Exception):
    """Refuses a request: a handler raises this exception to answer the request with an error, and a check of parameters
    to refuse a change.

    The requester receives `value` in a `ServiceError`. Nothing is logged.
    """

    def __init__(self, value: Any) -> None:
        super().__init__(value)
        #: The error to send: any value that `Robot.publish` accepts.
        self.value = value


class Request(Generic[T]):
    """A request to a service. `Request[Grab]` has a `value` of the type `Grab`.

    If a request is closed without a reply, the requester receives none.
    """

    __slots__ = (
        "_execution",
        "_key",
        "_mark",
        "_observer",
        "_query",
        "_replies",
        "_requester",
        "_session",
        "_value",
        "deadline",
        "payload",
        "sender",
    )

    def __init__(
        self,
        query: zenoh.Query,
        requester: _rect.Requester,
        payload: Payload,
        remaining: float,
        session: Session,
        key: str,
        execution: _rect.Execution | None,
        is_shared: bool,
    ) -> None:
        self._query = query
        self._session = session
        self._key = key
        self._value = UNREAD
        self._requester = requester
        self._observer: Executor | None = None
        #: The number of replies so far, if the requester counts them.
        self._replies = 0 if requester.is_stream else None
        #: Takes the result, if the request is carried out at most once.
        self._execution = execution
        #: The attachment of replies. Only one program carries out a request that is carried out at most once.
        self._mark = _rect.SHARED_REPLY if is_shared and execution is None else None
        #: Name of the robot that sent the request, as stated by its program. `None` if that program does not use RECT.
        #: The name is not verified: do not base permissions on it.
        self.sender = requester.robot
        #: The payload: bytes with an encoding.
        self.payload = payload
        #: Time at which the requester stops waiting, by `time.monotonic()`.
        self.deadline = time.monotonic() + remaining

    @property
    def value(self) -> T:
        """The decoded payload, as the type that the handler states; see `Message.value`."""
        value: T = self.payload.value if self._value is UNREAD else self._value
        return value

    def fit(self, converter: Converter[T]) -> None:
        """Converts the value to the type that the handler states. Raises `PayloadError`."""
        self._value = converter.convert(self.payload.value)

    @property
    def topic(self) -> str:
        """Topic of the service."""
        return self._key.split("/", 2)[2]

    @property
    def remaining(self) -> float:
        """Time until the requester stops waiting, in seconds; 0 if it has stopped."""
        return max(self.deadline - time.monotonic(), 0)

    @property
    def is_wanted(self) -> bool:
        """Whether the requester still waits for a reply, so that a handler can stop when nobody does.

        It does not wait after its deadline, or if it has closed the request, or if its program or robot has ended.
        Except for the deadline, this is known within 0.5 s. The end of a program is known if the program has a name,
        and that of a stock Zenoh program never. The first use begins to observe the requester, which sends nothing on
        the air.
        """
        self._observe()
        return not self._requester.has_left and self.remaining > 0

    async def unwanted(self) -> None:
        """Waits until nobody waits for a reply any more (`is_wanted`), for `async` handlers."""
        loop, left = asyncio.get_running_loop(), asyncio.Event()

        def on_left() -> None:
            with contextlib.suppress(RuntimeError):
                # The loop may have ended.
                loop.call_soon_threadsafe(left.set)

        await asyncio.to_thread(self._observe)
        self._requester.on_left(on_left)
        with contextlib.suppress(asyncio.TimeoutError):
            await asyncio.wait_for(left.wait(), self.remaining)

    @property
    def has_left(self) -> bool:
        """Whether the requester has closed the request. Unlike `is_wanted`, this observes nothing."""
        return self._requester.has_left

    def _observe(self) -> None:
        """Begins to observe the program and the robot of the requester, once."""
        driver = self._requester.observe(self._session.key_space)
        if driver is not None:
            self._observer = Executor(self._session, driver)
            self._observer.start("rect requester", self._requester.leave)

    def reply_all(self, values: Generator[Any, Any, Any]) -> None:
        """Sends each value as a reply, until there are no more or the requester has left."""
        for value in values:
            self.reply(value)
            if self.has_left:
                values.close()
        self.finish()

    def finish(self) -> None:
        """Ends a request after several replies, so that `Robot.request_stream` knows that all have arrived.

        A handler that returns, or a generator that ends, has finished. Raises `ZenohError`.
        """
        if self._replies is None:
            return
        end = _rect.end_of_replies(self._replies)
        try:
            with self._session.calls:
                self._query.reply(self._key, b"", attachment=end)
        except zenoh.ZError as error:
            raise zenoh_error("cannot send the reply", error) from error

    def reply(self, value: Any) -> None:
        """Sends a reply. May be called several times.

        Raises `PayloadError` and `ZenohError`.
        """
        payload = payload_of(value)
        self._answer(self._key, payload.bytes, payload.encoding)
        if self._replies is not None:
            self._replies += 1

    def refuse(self, error: Any) -> None:
        """Sends an error, which the requester receives as `ServiceError`.

        Raises `PayloadError` and `ZenohError`.
        """
        payload = payload_of(error)
        self._answer(None, payload.bytes, _rect.error_encoding(self._session.key_space.robot, payload.encoding))

    def close(self) -> None:
        """Ends the request: no more replies follow."""
        if self._observer is not None:
            self._observer.end()
        self._query.drop()
        # A repetition of a request that has no reply yet will get none.
        self._execution = None

    def _answer(self, key: str | None, payload: bytes, encoding: str) -> None:
        """Sends a reply, or an error (`None`), also to a repetition of the request that waits for it."""
        execution = self._execution
        repeated = None if execution is None else execution.on_result(key, payload, encoding)
        try:
            with self._session.calls:
                for query in (self._query,) if repeated is None else (repeated, self._query):
                    if key is None:
                        query.reply_err(payload, encoding=encoding)
                    else:
                        query.reply(key, payload, encoding=encoding, attachment=self._mark)
                if repeated is not None:
                    repeated.drop()
        except zenoh.ZError as error:
            raise zenoh_error("cannot send the reply", error) from error

    def refuse_for(self, error: BaseException) -> None:
        """Sends an error that describes the exception of a handler.

        Logs the exception unless it is a `Refusal` or a `RectError`, except for a value that cannot be sent or read.
        """
        if isinstance(error, Refusal):
            self.refuse(error.value)
            return
        if isinstance(error, PayloadError):
            _LOG.warning("the service %s replies with an error: %s", self.topic, error)
        elif not isinstance(error, RectError):
            _LOG.error("the handler of the service %s raised an exception", self.topic, exc_info=error)
        self.refuse(error_text(error))

    def __repr__(self) -> str:
        return f"Request({self.sender}, {self.topic})"


class Requests:
    """Receives the requests to a service, or the orders to change a group of parameters (without a handler)."""

    def __init__(
        self,
        session: Session,
        topic: str | _rect.InternalTopic,
        handler: Callable[..., Any] | None,
        about: str | None,
        allow_several: bool,
        parameters: _rect.ParameterDeclaration | None = None,
    ) -> None:
        converter = None if handler is None else request_converter(handler)
        if about is None:
            about = (inspect.getdoc(handler) or "").partition("\n")[0]
        session.program.serve(topic, about, allow_several, parameters)
        self._session = session
        self._topic = topic
        self._converter = converter
        self._is_shared = allow_several
        #: Held while the router is asked whether another program serves the topic.
        self._checking = threading.Lock()
        self._queue: ReceiveQueue[Admitted] = ReceiveQueue(_rect.SERVICE_CAPACITY, "drop_newest")
        self._key = session.key_space.publication(topic)
        service = (session.program.instance, self._on_taken_over, session.program.once)
        on_request = _rect.OnRequest(self._queue.queue, _refuse_overload(session.key_space.robot), service)
        self._declared = Declared(session, self._queue, lambda: session.program.end(topic))
        try:
            with session.calls:
                self._declared.add(session.zenoh.declare_queryable(self._key, direct(on_request), complete=True))
        except zenoh.ZError as error:
            self._declared.end()
            raise zenoh_error("cannot declare the service", error) from error

    def next(self) -> Request[Any]:
        """Waits for the next request that can still be answered. Raises `Ended`."""
        while True:
            request = self._request(*self._queue.pop())
            if request is not None and self._decode(request):
                return request

    async def next_async(self) -> Request[Any]:
        """Does the same as `next`, for asyncio."""
        while True:
            request = self._request(*await self._queue.pop_async())
            if request is not None and self._decode(request):
                return request

    def _request(
        self,
        query: zenoh.Query,
        requester: _rect.Requester,
        bytes: bytes,
        encoding: str,
        execution: _rect.Execution | None,
    ) -> Request[Any] | None:
        """Returns a request. One that is closed, or too late, ends without a reply."""
        remaining = requester.remaining()
        if remaining == 0:
            query.drop()
            return None
        payload = Payload(bytes, encoding)
        session, key, is_shared = self._session, self._key, self._is_shared
        return Request(query, requester, payload, remaining, session, key, execution, is_shared)

    def _decode(self, request: Request[Any]) -> bool:
        """Decodes the request, and returns whether to handle it.

        One that cannot be decoded, or whose value does not fit, is answered with the error.
        """
        sender = request.sender or self._session.key_space.robot
        try:
            request.payload = self._session.decoder.payload(sender, request.payload)
            if self._converter is not None:
                request.fit(self._converter)
        except PayloadError as error:
            if not isinstance(error, CodecError):
                on_problem(self._session, sender, request.topic, error)
            request.refuse(f"{request.topic}: {error}" if isinstance(error, MismatchError) else str(error))
            request.close()
            return False
        return True

    def _on_taken_over(self) -> None:
        """Begins to check whether another program serves the topic now, on a thread of its own: Zenoh's waits for this
        function."""
        if self._checking.acquire(blocking=False):
            threading.Thread(target=self._end_if_taken_over, name="rect taken over", daemon=True).start()

    def _end_if_taken_over(self) -> None:
        with contextlib.suppress(Closed):
            if self._session.program.is_taken_over(self._topic):
                self._declared.end()
        self._checking.release()

    def close(self) -> None:
        self._declared.end()


class Service:
    """Answers the requests to a topic by calling a function, for up to 16 requests concurrently.

    Returned by `Robot.serve`. It ends when it or the robot is closed.
    """

    def __init__(
        self,
        session: Session,
        topic: str,
        handler: Callable[[Request[Any]], Any],
        about: str | None,
        allow_several: bool,
    ) -> None:
        self._topic = topic
        self._handler = handler
        self._lock = threading.Lock()
        self._workers = 0
        self._idle = 0
        self._requests = Requests(session, topic, handler, about, allow_several)
        self._ensure_waiting_worker()

    def close(self) -> None:
        """Ends the service. Requests that are being handled are still answered."""
        self._requests.close()

    def __enter__(self) -> Service:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __call__(self, request: Request[Any]) -> Any:
        """Calls the handler, so that a function decorated by `@robot.serve` remains callable."""
        return self._handler(request)

    def __repr__(self) -> str:
        return f"Service({self._topic})"

    def _ensure_waiting_worker(self) -> None:
        """Starts a worker unless one waits for a request already, or the limit is reached."""
        with self._lock:
            if self._idle or self._workers >= _rect.MAX_CONCURRENT:
                return
            self._idle += 1
            self._workers += 1
        threading.Thread(target=self._work, name=f"rect {self._topic}", daemon=True).start()

    def _work(self) -> None:
        while True:
            try:
                request = self._requests.next()
            except Ended:
                return
            with self._lock:
                self._idle -= 1
            self._ensure_waiting_worker()
            answer(request, self._handler)
            with self._lock:
                self._idle += 1


def request_converter(
    handler: Callable[..., Any], generic: type = Request, name: str = "Request"
) -> Converter[Any] | None:
    """Returns the converter to the type that a handler states: `Grab` for the parameter `request: rect.Request[Grab]`.

    `generic`: the class of the parameter, or a base of it. `name`: its name in annotations.

    Raises `TypeError` if there is no such type, or values cannot be converted to it.
    """
    try:
        first = next(iter(inspect.signature(handler).parameters.values()), None)
    except (TypeError, ValueError):
        # Some functions in C have no signature.
        return None
    stated: Any = None if first is None or first.annotation is first.empty else first.annotation
    if isinstance(stated, str):
        if f"{name}[" not in stated:
            return None
        function = inspect.unwrap(handler)
        names = getattr(function, "__globals__", None) or getattr(type(handler).__call__, "__globals__", {})
        holder = types.SimpleNamespace(__annotations__={"request": stated})
        try:
            stated = typing.get_type_hints(holder, names)["request"]
        except NameError as error:
            text = (
                f"the type {stated} of the handler cannot be resolved: {error}. Define the classes outside of functions"
            )
            raise TypeError(text) from None
    origin = typing.get_origin(stated)
    is_generic = isinstance(origin, type) and issubclass(origin, generic)
    return converter_of(typing.get_args(stated)[0]) if is_generic else None


def error_text(error: BaseException) -> str:
    """Returns the text with which the requester is informed of the exception of a handler."""
    if isinstance(error, SystemExit):
        return f"the service called sys.exit({'' if error.code is None else repr(error.code)})"
    return str(error) or type(error).__name__


def _refuse_overload(me: str) -> Callable[[zenoh.Query], None]:
    def refuse(query: zenoh.Query) -> None:
        payload, encoding = _rect.busy_reply(me)
        with query:
            query.reply_err(payload, encoding=encoding)

    return refuse


def answer(request: Request[Any], handler: Callable[[Request[Any]], Any]) -> None:
    """Calls the handler and sends what it returns, yields or raises."""
    try:
        try:
            result = handler(request)
            if inspect.isgenerator(result):
                request.reply_all(result)
            else:
                request.reply(result)
                request.finish()
        except BaseException as error:
            # `sys.exit` included: it would end only this thread, and the requester would receive no reply.
            request.refuse_for(error)
    except Exception as error:
        _LOG.warning("cannot send a reply: %s", error)
    finally:
        request.close()
