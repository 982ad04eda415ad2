"""Decodes compressed payloads, and fetches the dictionaries that this requires from the robots that share them."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import zenoh

from rect import _rect
from rect._zenoh import direct, zenoh_error
from rect.errors import CodecError, RectError
from rect.executor import Executor
from rect.values import BYTES, CBOR, JSON, TEXT, Payload

if TYPE_CHECKING:
    from rect.session import Session

#: Encodings of payloads that no codec has encoded, as most are.
_PLAIN = frozenset((JSON, CBOR, TEXT, BYTES))
_LOG = logging.getLogger("rect")


class Decoder:
    """Decodes the messages of one program, and serves the dictionaries that it shares."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._core = _rect.Decoder(session.key_space)
        self._served: list[object] = []

    def payload(self, sender: str, payload: Payload) -> Payload:
        """Decodes a payload of that sender; fetches a missing dictionary first. Raises `CodecError`."""
        if payload.encoding in _PLAIN:
            return payload
        try:
            return self.payload_now(sender, payload)
        except CodecError as error:
            if error.dictionary is None or not self._fetch(sender, error.dictionary):
                raise
        return self.payload_now(sender, payload)

    def payload_now(self, sender: str, payload: Payload) -> Payload:
        """Decodes a payload of that sender with the dictionaries that are present. Raises `CodecError`."""
        decoded = self._core.decode(sender, payload.bytes, payload.encoding)
        return payload if decoded is None else Payload(*decoded)

    def _fetch(self, sender: str, id: int) -> bool:
        """Requests a dictionary from the sender. Returns whether it is present now."""
        driver = self._core.fetch(sender, id)
        if driver is None:
            return False
        try:
            reason = self._core.on_fetched(Executor(self._session, driver).run())
        except RectError:
            return False
        if reason is not None:
            _LOG.warning("%s", reason)
        return reason is None

    def serve(self, dictionary: _rect.Dictionary) -> None:
        """Serves the dictionary to other robots until the session closes. Raises `DictionaryError` and `ZenohError`."""
        key = self._core.serve(dictionary)
        if key is None:
            return

        def answer(query: zenoh.Query) -> None:
            with query:
                query.reply(key, bytes(dictionary))

        try:
            with self._session.calls:
                self._served.append(self._session.zenoh.declare_queryable(key, direct(answer), complete=True))
        except zenoh.ZError as error:
            self._core.on_not_served(dictionary.id)
            raise zenoh_error("cannot share the dictionary", error) from error
