"""Performs the actions of one driver of the core on eclipse-zenoh, and reports to the driver what Zenoh delivers."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

import zenoh

from rect import _rect
from rect._zenoh import call_interruptibly, direct, get_arguments, qos, undeclared, zenoh_error
from rect.declared import Declared
from rect.errors import Closed
from rect.receive_queue import ReceiveQueue
from rect.waiting import next_wait

if TYPE_CHECKING:
    from rect.session import Session

_LOG = logging.getLogger("rect")


class Executor:
    """Performs the actions of a driver.

    - `sink`: called with each item that the driver delivers, on a thread of Zenoh or on that of the driver.
    - `before_poll`: called before each poll of the driver.
    - `is_passive`: the driver needs no thread, because it has nothing to do after it has started.
    - `on`: the Zenoh session on which to perform them. Default: the one for normal messages.
    """

    def __init__(
        self,
        session: Session,
        driver: _rect.Driver,
        sink: Callable[[Any], object] | None = None,
        *,
        queue: ReceiveQueue[Any] | None = None,
        before_poll: Callable[[], object] | None = None,
        is_passive: bool = False,
        on: zenoh.Session | None = None,
    ) -> None:
        self._session = session
        self._zenoh = session.zenoh if on is None else on
        self._driver = driver
        self._sink = sink
        self._before_poll = before_poll
        self._is_passive = is_passive
        #: An entry for each time that the driver is to be polled. `put` runs no Python code.
        self._signals: SimpleQueue[None] = SimpleQueue()
        self._declared: dict[int, Any] = {}
        #: Queries that the driver has not answered, by their numbers.
        self._queries: dict[int, zenoh.Query] = {}
        self._is_ended = False
        self.declarations = Declared(session, queue, self._on_end)
        self.declarations.keep(self._queries)

    def start(self, name: str, on_finished: Callable[[], object] | None = None) -> None:
        """Performs the first actions now, and the others on a thread. Calls `on_finished` when the driver has finished.

        Raises `ZenohError`.
        """
        try:
            finished, wait = self._step()
        except zenoh.ZError as error:
            self.end()
            raise zenoh_error("cannot start the handle", error) from error
        except BaseException:
            self.end()
            raise
        if finished is None and not self._is_passive:
            self._session.start(name, lambda: self._run_on_thread(wait, on_finished))
        elif on_finished is not None and finished is not None:
            on_finished()

    def run(self) -> Any:
        """Runs the driver to its end, and returns its output. Raises `ZenohError` and `Closed`."""
        try:
            while True:
                finished, wait = self._step()
                if finished is not None:
                    return finished[0]
                self._wait(wait)
                if self._session.is_closed:
                    self._driver.on_closed()
        except zenoh.ZError as error:
            self._session.check()
            raise zenoh_error("cannot query", error) from error
        finally:
            self.end()

    def act(self, step: tuple[Any, ...]) -> None:
        """Performs an action of the driver. Raises `zenoh.ZError`, and `Closed` if the handle is closed."""
        if step[0] == "deliver":
            self._deliver(*step[1:])
            return
        with self._session.calls:
            getattr(self, "_" + step[0])(*step[1:])

    def wake(self) -> None:
        """Makes the thread poll the driver."""
        self._signals.put(None)

    def end(self) -> None:
        """Ends everything that the driver has declared."""
        self.declarations.end()

    def leave_with(self, handle: object) -> None:
        """Ends it without blocking when `handle` is garbage-collected without having been closed."""
        self.declarations.leave_with(handle)

    def _run_on_thread(self, wait: float | None, on_finished: Callable[[], object] | None) -> None:
        try:
            while not self._is_ended:
                self._wait(wait)
                if self._is_ended:
                    return
                finished, wait = self._step()
                if finished is not None:
                    if on_finished is not None:
                        on_finished()
                    return
        except (zenoh.ZError, Closed) as error:
            _LOG.debug("a driver has ended: %s", error)
        finally:
            self.end()

    def _step(self) -> tuple[tuple[Any] | None, float | None]:
        """Performs what is due. Returns the output of a finished driver in a tuple, or else how long to wait."""
        while True:
            if self._before_poll is not None:
                self._before_poll()
            step = self._driver.poll()
            if step[0] == "wait":
                return None, step[1]
            if step[0] == "finished":
                return (step[1],), None
            self.act(step)

    def _wait(self, seconds: float | None) -> None:
        """Waits until the driver is to be polled, for at most this time."""
        deadline = None if seconds is None else time.monotonic() + seconds
        while True:
            remaining = None if deadline is None else deadline - time.monotonic()
            if remaining is not None and remaining <= 0:
                return
            try:
                self._signals.get(timeout=next_wait(remaining))
            except Empty:
                if self._session.is_closed:
                    return
                continue
            while not self._signals.empty():
                self._signals.get()
            return

    def _on_end(self) -> None:
        self._is_ended = True
        self._signals.put(None)
        queries = dict(self._queries)
        self._queries.clear()
        if not self._session.is_closed:
            for query in queries.values():
                query.drop()

    def _report(self, id: int) -> _rect.Report:
        wake = None if self._is_passive else self._signals.put
        return _rect.Report(self._driver, id, self._sink, wake, self._queries)

    def _add(self, id: int, declared: Any) -> None:
        self._declared[id] = declared
        self.declarations.add(declared)

    # The steps of a driver, by their names (rect-py/src/driver/step.rs).

    def _declare_publisher(self, id: int, key: str, qos_fields: tuple[int, bool, bool], observes: bool) -> None:
        publisher = self._zenoh.declare_publisher(key, **qos(qos_fields))
        self._add(id, publisher)
        if observes:
            report = self._report(id)
            self.declarations.add(publisher.declare_matching_listener(direct(report.matching)))
            # This is a `MatchingStatus`; the stubs of eclipse-zenoh 1.10 are wrong here.
            report.matching(publisher.matching_status)

    def _declare_subscriber(self, id: int, key: str) -> None:
        self._add(id, self._zenoh.declare_subscriber(key, direct(self._report(id).sample)))

    def _declare_queryable(self, id: int, key: str, complete: bool) -> None:
        declare = self._zenoh.declare_queryable
        self._add(id, declare(key, direct(self._report(id).query), complete=complete))

    def _declare_token(self, id: int, key: str) -> None:
        self._add(id, self._zenoh.liveliness().declare_token(key))

    def _declare_liveliness_subscriber(self, id: int, key: str) -> None:
        declare = self._zenoh.liveliness().declare_subscriber
        # Zenoh calls the callback during the declaration, and ignores a KeyboardInterrupt in it.
        subscriber = call_interruptibly(
            lambda: declare(key, direct(self._report(id).sample), history=True), lambda one: one.undeclare()
        )
        self._add(id, subscriber)

    def _declare_link_listener(self, id: int) -> None:
        info = self._zenoh.info
        self._add(id, info.declare_link_events_listener(direct(self._report(id).link), history=False))

    def _undeclare(self, id: int) -> None:
        declared = self._declared.pop(id, None)
        if declared is not None and self.declarations.remove(declared):
            undeclared(declared)

    def _put(self, publisher: int, payload: bytes, encoding: str, attachment: bytes | None) -> None:
        declared = self._declared.get(publisher)
        if declared is None or self._is_ended:
            raise self._session.closed_error("handle")
        declared.put(payload, encoding=encoding, attachment=attachment)

    def _put_once(self, key: str, payload: bytes, encoding: str, qos_fields: tuple[int, bool, bool]) -> None:
        self._zenoh.put(key, payload, encoding=encoding, **qos(qos_fields))

    def _put_retained(
        self,
        key: str,
        payload: tuple[bytes, str] | None,
        qos_fields: tuple[int, bool, bool],
        attachment: bytes,
    ) -> None:
        if payload is None:
            self._zenoh.delete(key, attachment=attachment, **qos(qos_fields))
        else:
            bytes, encoding = payload
            self._zenoh.put(key, bytes, encoding=encoding, attachment=attachment, **qos(qos_fields))

    def _get(self, id: int, *query: Any) -> None:
        report = self._report(id)
        selector, arguments = get_arguments(*query)
        try:
            self._zenoh.get(selector, direct(report.reply, report.ended), **arguments)
        except zenoh.ZError as error:
            # Zenoh has called `report.ended`.
            _LOG.debug("cannot query %s: %s", selector, error)

    def _get_liveliness(self, id: int, selector: str, timeout: float) -> None:
        report = self._report(id)
        self._zenoh.liveliness().get(selector, direct(report.reply, report.ended), timeout=timeout)

    def _reply(self, query: int, key: str, payload: bytes, encoding: str) -> None:
        self._answer(query, lambda open: open.reply(key, payload, encoding=encoding))

    def _answer_retained(self, query: int, replies: list[tuple[str, tuple[bytes, str], bytes]]) -> None:
        def answer(open: zenoh.Query) -> None:
            for key, (payload, encoding), attachment in replies:
                open.reply(key, payload, encoding=encoding, attachment=attachment)

        self._answer(query, answer)

    def _reply_error(self, query: int, payload: bytes, encoding: str) -> None:
        self._answer(query, lambda open: open.reply_err(payload, encoding=encoding))

    def _end_query(self, query: int) -> None:
        self._answer(query, lambda _: None)

    def _answer(self, query: int, answer: Callable[[zenoh.Query], object]) -> None:
        open = self._queries.pop(query, None)
        if open is None:
            return
        with open:
            try:
                answer(open)
            except zenoh.ZError as error:
                # The protocols that need the answer repeat the query.
                _LOG.debug("cannot answer a query: %s", error)

    def _deliver(self, item: Any) -> None:
        if self._sink is not None:
            self._sink(item)
