"""Owns asking the routers' registry: who is there, and by which connections (docs/registry.md has the keys)."""

from __future__ import annotations

import html
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import zenoh

from rect import _rect
from rect._zenoh import direct, payload_bytes, refused
from rect.errors import NoService, PayloadError
from rect.inbox import Ended, Inbox
from rect.request import service_error
from rect.values import JSON, Payload

if TYPE_CHECKING:
    from rect.session import Session

#: Routers answer at once; a slow link with much on it takes a while.
_PATIENCE_S = 5.0
_ANSWERS = 4096


@dataclass(frozen=True)
class Peer:
    """Who is at the other end."""

    #: Zenoh's id of its router or program.
    id: str
    #: The robot, where it is one of RECT.
    robot: str | None = None


@dataclass(frozen=True)
class Connection:
    """A connection of a robot's router."""

    #: `ble`, `tcp`, `udp`...
    method: str
    #: Whom or where, without the method.
    address: str
    #: `connected`, `connecting` (wanted, and not there), `discovered` (a robot that is heard, and not linked).
    state: str
    #: As the file of connections names it, if it does.
    name: str | None = None
    #: Who is at the other end, once that is known.
    peer: Peer | None = None
    #: For how long it has been there, in seconds.
    up_s: float | None = None
    #: What went out, `{"batches": ..., "bytes": ...}`, where it is counted; `batches` is None where only bytes are.
    sent: dict[str, int | None] | None = None
    #: What came, where it is counted.
    received: dict[str, int | None] | None = None
    #: There and back, in milliseconds, where it is measured.
    round_trip_ms: float | None = None
    #: How strong its signal is, where it was heard within a minute.
    rssi_dbm: int | None = None
    #: How often it was made.
    linked: int | None = None
    #: Attempts that came to nothing since then.
    failed: int | None = None
    #: What went wrong last: `{"what": ..., "ago_s": ...}`.
    last_error: dict[str, Any] | None = None

    @property
    def robot(self) -> str | None:
        """The robot at the other end, where that is known."""
        return None if self.peer is None else self.peer.robot


class Connections(list[Connection]):
    """The connections of a robot: a list, which a notebook shows as a table."""

    def _repr_html_(self) -> str:
        columns = ("name", "method", "address", "state", "robot", "up_s", "round_trip_ms", "rssi_dbm")
        head = "".join(f"<th>{column}</th>" for column in columns)
        rows = ("".join(f"<td>{_cell(getattr(connection, column))}</td>" for column in columns) for connection in self)
        return f"<table><tr>{head}</tr>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"


def ask(session: Session, robot: str, question: str, which: str) -> Any:
    """The answer of a robot's registry to a question (docs/registry.md), of those that `which` selects."""
    return _ask_router(session, robot, question, which, None).value


def configure(session: Session, robot: str, how: str, what: str) -> None:
    """Changes a robot's connections."""
    _ask_router(session, robot, _rect.CONFIG, f"{how};by={session.place.robot}", what.encode())


def _of_registry(question: str) -> str:
    """What was asked for, for the error that nobody answers."""
    if question != _rect.CONFIG:
        return f"the registry ({question})"
    return (
        "changes of connections (the router's access control has to allow them, and its settings have to name a "
        "connections file)"
    )


def _ask_router(session: Session, robot: str, question: str, parameters: str, payload: bytes | None) -> Payload:
    key = session.place.own(robot, question)
    replies: Inbox[zenoh.Reply] = Inbox(1, "oldest wins")
    session.inboxes.add(replies)
    try:
        selector = f"{key}?{parameters}" if parameters else key
        session.zenoh.get(selector, direct(replies.queue, replies.queue.end), timeout=_PATIENCE_S, payload=payload)
        reply = replies.pop(_PATIENCE_S)
    except zenoh.ZError as error:
        raise refused("the router can't be asked", error) from None
    except (Ended, TimeoutError):
        raise NoService(robot, _of_registry(question), peers(session)) from None
    finally:
        session.inboxes.discard(replies)
    if reply.ok is not None:
        return Payload(payload_bytes(reply.ok.payload), JSON)
    said = payload_bytes(None if reply.err is None else reply.err.payload)
    raise service_error(robot, Payload(said, "text/plain"))


def peers(session: Session) -> list[str]:
    """The other robots of the fleet that are there now, by name."""
    replies: Inbox[zenoh.Reply] = Inbox(_ANSWERS, "oldest wins")
    session.inboxes.add(replies)
    there = set()
    try:
        alive = session.place.own(None, "alive/*")
        session.zenoh.liveliness().get(alive, direct(replies.queue, replies.queue.end), timeout=_PATIENCE_S)
        while True:
            reply = replies.pop(_PATIENCE_S)
            if reply.ok is not None:
                there.add(session.place.robot_of(str(reply.ok.key_expr)))
    except zenoh.ZError as error:
        raise refused("who is there is not known", error) from None
    except (Ended, TimeoutError):
        session.check()
    finally:
        session.inboxes.discard(replies)
    return sorted(robot for robot in there - {session.place.robot} if robot is not None)


def connections(session: Session, robot: str, which: str) -> Connections:
    """The connections of a robot's router."""
    return Connections(_connection(one) for one in ask(session, robot, "connections", which))


def _connection(told: Any) -> Connection:
    try:
        known = {field.name: told.get(field.name) for field in fields(Connection)}
        peer = known.pop("peer")
        return Connection(**known, peer=None if peer is None else Peer(peer["id"], peer.get("robot")))
    except (AttributeError, KeyError, TypeError) as error:
        text = f"the payload says that it is JSON, and is not, or not of the wanted shape: {error!r}"
        raise PayloadError(text, "read") from None


def _cell(value: object) -> str:
    return "" if value is None else html.escape(str(value))
