"""Receives the queries for a recorder: those for its recording, and the requests to its robot, which it records."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING

import zenoh

from rect import _rect
from rect._zenoh import direct, payload_bytes, zenoh_error
from rect.declared import Declared
from rect.receive_queue import Ended, ReceiveQueue

if TYPE_CHECKING:
    from rect.session import Session

_LOG = logging.getLogger("rect")


class RecordingQueries:
    """Answers queries for a recording on a thread of its own, and records requests, until it is closed."""

    def __init__(self, session: Session, recorder: _rect.Recorder) -> None:
        self._session = session
        self._recorder = recorder
        self._queue: ReceiveQueue[zenoh.Query] = ReceiveQueue(_rect.RECORDING_QUERIES, "drop_newest")
        self._declared = Declared(session, self._queue)
        on_query = direct(_rect.OnRequest(self._queue.queue, self._refuse))
        try:
            with session.calls:
                self._id = session.zenoh.new_timestamp().get_id()
                self._declared.add(session.zenoh.declare_queryable(recorder.queries, on_query, complete=True))
                # A request is sent to all programs that declare its key.
                self._declared.add(session.zenoh.declare_queryable(recorder.services, direct(self._record)))
        except zenoh.ZError as error:
            self._declared.end()
            raise zenoh_error("cannot offer the recording", error) from error
        threading.Thread(target=self._answer_all, name="rect recording", daemon=True).start()

    def close(self) -> None:
        self._declared.end()

    def _record(self, query: zenoh.Query) -> None:
        with query:
            attachment = None if query.attachment is None else query.attachment.to_bytes()
            encoding = "" if query.encoding is None else str(query.encoding)
            self._recorder.add_request(str(query.key_expr), attachment, payload_bytes(query.payload), encoding)

    def _refuse(self, query: zenoh.Query) -> None:
        payload, encoding = self._recorder.busy()
        with query:
            query.reply_err(payload, encoding=encoding)

    def _answer_all(self) -> None:
        while True:
            try:
                query = self._queue.pop()
            except Ended:
                return
            try:
                self._answer(query)
            except Exception as error:
                _LOG.debug("cannot reply on %s: %s", query.key_expr, error)
            finally:
                query.drop()

    def _answer(self, query: zenoh.Query) -> None:
        answer = self._recorder.answer(str(query.key_expr), str(query.parameters))
        if answer is None:
            return
        replies, error = answer
        with self._session.calls:
            for key, (payload, encoding), recorded in replies:
                time = None if recorded is None else zenoh.Timestamp(zenoh.NTP64(*recorded), self._id)
                query.reply(key, payload, encoding=encoding, timestamp=time)
            if error is not None:
                payload, encoding = error
                query.reply_err(payload, encoding=encoding)
