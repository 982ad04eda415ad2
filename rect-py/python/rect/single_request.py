"""Sends a request to the service of one robot, and waits for its first reply in the channel of Zenoh.

This is faster than `Replies`, whose callback takes the interpreter's lock for each reply, and again when they end.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import zenoh

from rect import _rect
from rect._zenoh import zenoh_error
from rect.errors import Interrupted, RectError, TimedOut
from rect.querier import Destination
from rect.reply import Reply
from rect.request import announce_close, received_of
from rect.typed import Converter, T
from rect.values import Payload

if TYPE_CHECKING:
    from rect.session import Session


class SingleRequest:
    """A request that waits for its first reply. The session and a fork end the wait as they do with a receive queue."""

    def __init__(self, session: Session, destination: Destination, payload: Payload, timeout: float) -> None:
        self._session = session
        self._destination = destination
        self._payload = payload
        self._timeout = timeout
        self._deadline = time.monotonic() + timeout
        self._cancellation = zenoh.CancellationToken()
        self._inquiry, self._attachment = destination.inquiry.another(timeout, session.program.request_ids)

    def run(self, converter: Converter[T] | None) -> Reply[T]:
        """Sends the request, and returns the reply. Raises the errors of `Robot.request`.

        Zenoh must have reported that somebody serves the topic.
        """
        session = self._session
        session.receive_queues.add(self)
        try:
            received = self._inquiry.on_reply(self._receive())
        except BaseException as error:
            self._leave()
            if isinstance(error, zenoh.ZError):
                session.check()
                if time.monotonic() >= self._deadline:
                    # Zenoh sends no error if the timeout is 0.
                    raise self._timed_out() from None
                # The query has ended, although somebody served the topic when it was sent.
                raise Interrupted(*self._destination.asked) from None
            raise
        finally:
            session.receive_queues.discard(self)
        # Only a stream has replies without a meaning.
        assert received is not None
        kind, robot, payload, is_shared = received
        if kind == "timed_out":
            raise self._timed_out()
        _, reply = received_of(session, converter, kind, robot, Payload(*payload), is_shared)
        if isinstance(reply, RectError):
            raise reply
        return reply

    def _receive(self) -> zenoh.Reply:
        session, destination, payload = self._session, self._destination, self._payload
        # A thread must not be in the channel when Python exits, either.
        with session.calls:
            try:
                replies = session.urgency_sessions.of(destination.urgency).get(
                    destination.key_expr,
                    zenoh.handlers.FifoChannel(_rect.MAX_REPLIES),
                    payload=payload.bytes,
                    encoding=payload.encoding,
                    attachment=self._attachment,
                    timeout=self._timeout,
                    cancellation_token=self._cancellation,
                    **destination.arguments,
                )
            except zenoh.ZError as error:
                raise zenoh_error("cannot send the request", error) from error
            return replies.recv()

    def _timed_out(self) -> TimedOut:
        return TimedOut(self._inquiry.expected, self._timeout)

    def _leave(self) -> None:
        """Lets the service know that nobody waits, and cancels the request later, without blocking now."""
        if not self._session.is_closed and announce_close(self._session, self._inquiry):
            self._session.abandoned.append(self)

    def end(self) -> None:
        """Cancels the request."""
        with self._session.calls:
            self._cancellation.cancel()

    def close(self) -> None:
        """Ends the wait for the reply, on another thread."""
        self._cancellation.cancel()

    def on_fork(self) -> None:
        """Does nothing: the thread that waits does not exist in a child process, which keeps its objects."""
