"""Queries the registry of routers (docs/reference/registry.md): reachable robots, and their connections."""

from __future__ import annotations

import html
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import zenoh

from rect import _rect
from rect._zenoh import direct, payload_bytes, zenoh_error
from rect.choices import ConnectionState
from rect.errors import NoService, PayloadError, TimedOut
from rect.receive_queue import Ended, ReceiveQueue
from rect.request import ZENOH_TIMEOUT, service_error
from rect.values import JSON, Payload

if TYPE_CHECKING:
    from rect.session import Session

#: Timeout of a query, in seconds. A router answers at once, but a congested slow link adds delay.
_TIMEOUT_S = 5.0
_ANSWERS = 4096


@dataclass(frozen=True)
class Peer:
    """The other end of a connection."""

    #: Zenoh id of the router or program.
    id: str
    #: Name of the robot. `None` if it is unknown, or if the peer does not use RECT.
    robot: str | None = None


@dataclass(frozen=True)
class Connection:
    """A connection of a robot's router."""

    #: Method of the link: `ble`, `tcp`, `udp` and so on.
    method: str
    #: Address of the peer, without the method.
    address: str
    #: State: `connected`, `connecting` or `discovered`.
    state: ConnectionState
    #: Name in the connections file. `None` if the connection has none.
    name: str | None = None
    #: The other end, once it is known.
    peer: Peer | None = None
    #: Time since the link was opened, in seconds. `None` if there is no link.
    up_s: float | None = None
    #: Batches and bytes sent: `{"batches": ..., "bytes": ...}`. `None` if they are not counted; `batches` is `None` if
    #: only bytes are counted.
    sent: dict[str, int | None] | None = None
    #: Batches and bytes received, in the same form.
    received: dict[str, int | None] | None = None
    #: Round trip, in milliseconds. `None` if it is not measured.
    round_trip_ms: float | None = None
    #: Received signal strength, in dBm. `None` if no signal was received within the last minute.
    rssi_dbm: int | None = None
    #: Number of times that the link was opened. `None` if it is not counted.
    linked: int | None = None
    #: Number of failed attempts since the link was last opened. `None` if they are not counted.
    failed: int | None = None
    #: The last error, and its age in seconds: `{"what": ..., "ago_s": ...}`. `None` if there was none.
    last_error: dict[str, Any] | None = None

    @property
    def robot(self) -> str | None:
        """Name of the robot at the other end. `None` if it is unknown."""
        return None if self.peer is None else self.peer.robot


class Connections(list[Connection]):
    """A list of the connections of a robot. A notebook displays it as a table."""

    def _repr_html_(self) -> str:
        columns = ("name", "method", "address", "state", "robot", "up_s", "round_trip_ms", "rssi_dbm")
        head = "".join(f"<th>{column}</th>" for column in columns)
        rows = ("".join(f"<td>{_cell(getattr(connection, column))}</td>" for column in columns) for connection in self)
        return f"<table><tr>{head}</tr>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"


def query(session: Session, robot: str, question: str, filter: str) -> Any:
    """Returns the answer of a robot's registry (docs/reference/registry.md) about what `filter` selects."""
    return _query_router(session, robot, question, filter, None).value


def configure(session: Session, robot: str, action: str, argument: str) -> None:
    """Adds or removes a connection of a robot's router."""
    _query_router(session, robot, _rect.CONFIG, f"{action};by={session.key_space.robot}", argument.encode())


def _service_name(question: str) -> str:
    """Returns the description of a question for the error that no router answers it."""
    if question != _rect.CONFIG:
        return f"the registry ({question})"
    return (
        "changes of connections (the router's access control must allow them, and its settings must name a "
        "connections file)"
    )


def _query_router(session: Session, robot: str, question: str, parameters: str, payload: bytes | None) -> Payload:
    key = session.key_space.own(robot, question)
    replies: ReceiveQueue[zenoh.Reply] = ReceiveQueue(1, "drop_newest")
    session.receive_queues.add(replies)
    try:
        selector = f"{key}?{parameters}" if parameters else key
        session.zenoh.get(selector, direct(replies.queue, replies.queue.end), timeout=_TIMEOUT_S, payload=payload)
        reply = replies.pop(_TIMEOUT_S)
    except zenoh.ZError as error:
        raise zenoh_error("cannot query the router", error) from None
    except Ended:
        raise NoService(robot, _service_name(question), peers(session)) from None
    except TimeoutError:
        raise _timed_out(robot, question) from None
    finally:
        session.receive_queues.discard(replies)
    if reply.ok is not None:
        return Payload(payload_bytes(reply.ok.payload), JSON)
    error_bytes = payload_bytes(None if reply.err is None else reply.err.payload)
    if error_bytes == ZENOH_TIMEOUT:
        raise _timed_out(robot, question)
    raise service_error(robot, Payload(error_bytes, "text/plain"))


def _timed_out(robot: str, question: str) -> TimedOut:
    return TimedOut(f"reply from the router of {robot} about {question}", _TIMEOUT_S)


def peers(session: Session) -> list[str]:
    """Returns the names of the other robots of the fleet that are reachable now, in order."""
    replies: ReceiveQueue[zenoh.Reply] = ReceiveQueue(_ANSWERS, "drop_newest")
    session.receive_queues.add(replies)
    reachable = set()
    try:
        alive = session.key_space.own(None, "alive/*")
        session.zenoh.liveliness().get(alive, direct(replies.queue, replies.queue.end), timeout=_TIMEOUT_S)
        while True:
            reply = replies.pop(_TIMEOUT_S)
            if reply.ok is not None:
                reachable.add(session.key_space.robot_of(str(reply.ok.key_expr)))
    except zenoh.ZError as error:
        raise zenoh_error("cannot query which robots are reachable", error) from None
    except (Ended, TimeoutError):
        session.check()
    finally:
        session.receive_queues.discard(replies)
    return sorted(robot for robot in reachable - {session.key_space.robot} if robot is not None)


def connections(session: Session, robot: str, filter: str) -> Connections:
    """Returns those connections of a robot's router that `filter` selects."""
    return Connections(_connection(row) for row in query(session, robot, "connections", filter))


def _connection(row: Any) -> Connection:
    try:
        values = {field.name: row.get(field.name) for field in fields(Connection)}
        peer = values.pop("peer")
        return Connection(**values, peer=None if peer is None else Peer(peer["id"], peer.get("robot")))
    except (AttributeError, KeyError, TypeError) as error:
        text = f"the payload is not a list of connections in JSON: {error!r}"
        raise PayloadError(text, "read") from None


def _cell(value: object) -> str:
    return "" if value is None else html.escape(str(value))
