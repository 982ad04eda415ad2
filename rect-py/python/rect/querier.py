"""Observes whether somebody serves what a program requests, and prepares its requests."""

from __future__ import annotations

from typing import Any

import zenoh

from rect import _rect
from rect._zenoh import direct, get_arguments, undeclared, zenoh_error


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


class Destination:
    """A service of one robot, with what all requests to it have in common."""

    def __init__(self, key_space: _rect.KeySpace, ids: _rect.RequestIds, robot: str, topic: str, urgency: str) -> None:
        #: The robot and the topic.
        self.asked = robot, topic
        self.urgency = urgency
        #: The request of which each one is another.
        self.inquiry = _rect.Inquiry(key_space, robot, topic, 0, ids, False)
        _, _, *query = self.inquiry.get(b"", "", urgency)
        #: The key of the service.
        self.key, self.arguments = get_arguments(*query)
        for name in ("payload", "encoding", "attachment", "timeout"):
            del self.arguments[name]
        #: The key, parsed.
        self.key_expr = zenoh.KeyExpr(self.key)
        #: Whether somebody serves the key; set when it is observed.
        self.served: _rect.Served
