"""Decodes compressed payloads, and fetches the dictionaries that this requires from the robots that share them."""

from __future__ import annotations

import logging
import threading
import time

import zenoh

from rect import _rect
from rect._zenoh import direct, payload_bytes, zenoh_error
from rect.errors import CodecError, DictionaryError
from rect.receive_queue import Ended, ReceiveQueue
from rect.values import Payload

_LOG = logging.getLogger("rect")
#: Timeout for fetching a dictionary, in seconds: 100 kB at 34 kB/s, plus other traffic on the link.
_TIMEOUT_S = 5.0
#: Minimum interval between two requests for a missing dictionary, in seconds, so that not every message waits for it.
_QUERY_INTERVAL_S = 30.0
#: Maximum number of missing dictionaries to remember.
_MAX_MISSING = 256


class Decoder:
    """Decodes the messages of one program, and serves the dictionaries that it shares."""

    def __init__(self, session: zenoh.Session, key_space: _rect.KeySpace) -> None:
        self._session = session
        self._key_space = key_space
        self._lock = threading.Lock()
        self._dictionaries = _rect.DictionaryStore()
        self._missing: dict[tuple[str, int], float] = {}
        self._served: dict[int, object] = {}

    def payload(self, sender: str, payload: Payload) -> Payload:
        """Decodes a payload of that sender; fetches a missing dictionary first. Raises `CodecError`."""
        try:
            return self.payload_now(sender, payload)
        except CodecError as error:
            if error.dictionary is None or not self.fetch(sender, error.dictionary):
                raise
        return self.payload_now(sender, payload)

    def payload_now(self, sender: str, payload: Payload) -> Payload:
        """Decodes a payload of that sender with the dictionaries that are present. Raises `CodecError`."""
        if not _rect.is_encoded(payload.encoding):
            return payload
        return Payload(*self._dictionaries.decode(sender, payload.bytes, payload.encoding))

    def fetch(self, sender: str, id: int) -> bool:
        """Requests a dictionary from the sender. Returns whether it is present now."""
        key = (sender, id)
        with self._lock:
            queried_at = self._missing.get(key)
        if queried_at is not None and time.monotonic() - queried_at < _QUERY_INTERVAL_S:
            return False
        found = self._query(sender, id)
        with self._lock:
            if found is not None:
                self._dictionaries.add(sender, found)
                return True
            if len(self._missing) >= _MAX_MISSING:
                self._missing.clear()
            self._missing[key] = time.monotonic()
        _LOG.warning("%s did not send its dictionary %d: messages that need it are delivered undecoded", sender, id)
        return False

    def share_dictionary(self, dictionary: _rect.Dictionary) -> None:
        """Serves the dictionary to other robots until the session closes."""
        with self._lock:
            if dictionary.id in self._served:
                return
            key = self._key(self._key_space.robot, dictionary.id)

            def answer(query: zenoh.Query) -> None:
                with query:
                    query.reply(key, bytes(dictionary))

            try:
                declared = self._session.declare_queryable(key, direct(answer), complete=True)
            except zenoh.ZError as error:
                raise zenoh_error("cannot share the dictionary", error) from None
            self._served[dictionary.id] = declared
            # This program may subscribe to its own messages.
            self._dictionaries.add(self._key_space.robot, dictionary)

    def _query(self, sender: str, id: int) -> _rect.Dictionary | None:
        replies: ReceiveQueue[zenoh.Reply] = ReceiveQueue(16, "drop_newest")
        try:
            self._session.get(
                self._key(sender, id),
                direct(replies.queue, replies.queue.end),
                timeout=_TIMEOUT_S,
                priority=zenoh.Priority.DATA_HIGH,
            )
            while True:
                reply = replies.pop(_TIMEOUT_S)
                if reply.ok is None:
                    continue
                try:
                    dictionary = _rect.Dictionary(payload_bytes(reply.ok.payload))
                except DictionaryError:
                    continue
                if dictionary.id == id:
                    return dictionary
        except (Ended, TimeoutError, zenoh.ZError):
            return None
        finally:
            replies.close()

    def _key(self, robot: str, id: int) -> str:
        """Returns the key under which a robot serves a dictionary."""
        return self._key_space.own(robot, f"dictionary/{id}")
