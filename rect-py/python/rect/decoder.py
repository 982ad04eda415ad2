"""Owns undoing what a sender's codec has packed, and fetching the dictionaries for that from whoever made them."""

from __future__ import annotations

import logging
import threading
import time

import zenoh

from rect import _rect
from rect._zenoh import direct, payload_bytes, refused
from rect.errors import CodecError, DictionaryError
from rect.inbox import Ended, Inbox
from rect.values import Payload

_LOG = logging.getLogger("rect")
#: How long a dictionary may take to come: 100 kB at 34 kB/s, and what else is on the link.
_PATIENCE_S = 5.0
#: Who did not have it is asked again after this time at the earliest, so that messages of that kind do not wait each.
_ASK_AGAIN_S = 30.0
#: The most that are remembered as not to be had.
_MAX_MISSING = 256


class Decoder:
    """What one program knows of codecs."""

    def __init__(self, session: zenoh.Session, place: _rect.Place) -> None:
        self._session = session
        self._place = place
        self._lock = threading.Lock()
        self._known = _rect.Known()
        self._missing: dict[tuple[str, int], float] = {}
        self._served: dict[int, object] = {}

    def payload(self, sender: str, packed: Payload) -> Payload:
        """A payload of that robot's as it was before it was packed; fetches what is needed for that."""
        try:
            return self.payload_now(sender, packed)
        except CodecError as error:
            if error.dictionary is None or not self.fetch(sender, error.dictionary):
                raise
        return self.payload_now(sender, packed)

    def payload_now(self, sender: str, packed: Payload) -> Payload:
        """The same with what is known already."""
        if not _rect.is_packed(packed.encoding):
            return packed
        return Payload(*self._known.unpack(sender, packed.bytes, packed.encoding))

    def fetch(self, sender: str, id: int) -> bool:
        """Asks the sender for a dictionary; whether it is here now."""
        which = (sender, id)
        with self._lock:
            asked = self._missing.get(which)
        if asked is not None and time.monotonic() - asked < _ASK_AGAIN_S:
            return False
        found = self._ask(sender, id)
        with self._lock:
            if found is not None:
                self._known.add(sender, found)
                return True
            if len(self._missing) >= _MAX_MISSING:
                self._missing.clear()
            self._missing[which] = time.monotonic()
        _LOG.warning("%s has no dictionary %d: its messages that were packed with it stay packed", sender, id)
        return False

    def share(self, dictionary: _rect.Dictionary) -> None:
        """Gives it to whoever asks, until the session ends."""
        with self._lock:
            if dictionary.id in self._served:
                return
            key = self._key(self._place.robot, dictionary.id)

            def answer(query: zenoh.Query) -> None:
                with query:
                    query.reply(key, bytes(dictionary))

            try:
                declared = self._session.declare_queryable(key, direct(answer), complete=True)
            except zenoh.ZError as error:
                raise refused("the dictionary can't be shared", error) from None
            self._served[dictionary.id] = declared
            # One's own messages are heard, too.
            self._known.add(self._place.robot, dictionary)

    def _ask(self, sender: str, id: int) -> _rect.Dictionary | None:
        replies: Inbox[zenoh.Reply] = Inbox(16, "oldest wins")
        try:
            self._session.get(
                self._key(sender, id),
                direct(replies.queue, replies.queue.end),
                timeout=_PATIENCE_S,
                priority=zenoh.Priority.DATA_HIGH,
            )
            while True:
                reply = replies.pop(_PATIENCE_S)
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
        """Where a robot has a dictionary that it made."""
        return self._place.own(robot, f"dictionary/{id}")
