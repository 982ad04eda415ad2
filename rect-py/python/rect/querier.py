"""Observes whether somebody serves what a program requests."""

from __future__ import annotations

from typing import Any

import zenoh

from rect import _rect
from rect._zenoh import direct, undeclared, zenoh_error


class Querier:
    """A querier of Zenoh, declared for its reports alone: it has the router tell the session who serves the key.

    The requests of that key are sent by the session.
    """

    def __init__(self, session: zenoh.Session, key: str) -> None:
        served = _rect.Served()
        #: Whether somebody serves the key.
        self.served = served
        try:
            # Services are complete. A recorder is not, and receives every request.
            self._querier = session.declare_querier(key, target=zenoh.QueryTarget.ALL_COMPLETE)
            self._listener = self._querier.declare_matching_listener(
                direct(lambda status: served.on_matching(status.matching))
            )
        except zenoh.ZError as error:
            raise zenoh_error("cannot send the request", error) from error

    def is_served(self) -> bool:
        """Asks Zenoh whether somebody serves the key now. If it cannot say, somebody may."""
        try:
            # This is a `MatchingStatus`; the stubs of eclipse-zenoh 1.10 are wrong here.
            status: Any = self._querier.matching_status
        except zenoh.ZError:
            return True
        return bool(status.matching)

    def undeclare(self) -> None:
        """Ends the reports."""
        undeclared(self._listener)
        undeclared(self._querier)
