"""Queries the registry of routers (docs/reference/registry.md): reachable robots, and their connections."""

from __future__ import annotations

import html
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, TypeVar

from rect import _rect
from rect.choices import ConnectionState
from rect.errors import Closed, NoService, PayloadError, TimedOut
from rect.executor import Executor
from rect.reply import service_error
from rect.values import Payload

if TYPE_CHECKING:
    from rect.session import Session

#: A part of a connection.
_Part = TypeVar("_Part", "LinkPath", "LinkLane")


@dataclass(frozen=True)
class Peer:
    """The other end of a connection."""

    #: Zenoh id of the router or program.
    id: str
    #: Name of the robot. `None` if it is unknown, or if the peer does not use RECT.
    robot: str | None = None


@dataclass(frozen=True)
class LinkPath:
    """A path of a link whose method is `any`."""

    #: Method of the path: `ble` or `tcp`.
    method: str
    #: State: `untried` (it has not answered yet), `live`, or `suspected` (its acknowledgements are missing).
    state: str
    #: Whether it carries the bulk. Urgent messages travel on every live path.
    is_primary: bool
    #: Mean round trip, in milliseconds. `None` if it was not measured.
    round_trip_ms: float | None
    #: Rate, in bytes per second: measured, or assumed until then.
    bytes_per_s: float
    #: Bytes sent over this path.
    sent_bytes: int
    #: Those of them that another path had carried before.
    resent_bytes: int


@dataclass(frozen=True)
class LinkLane:
    """The sending side of a link for one of Zenoh's priorities."""

    #: Zenoh's priority, such as `Data`.
    priority: str
    #: Bytes that wait to be sent.
    waiting_bytes: int
    #: Mean time until the peer has acknowledged a batch, in milliseconds, with the time for which it has waited. `None`
    #: if it was not measured.
    delay_ms: float | None
    #: Batches that were withdrawn, because Zenoh dropped their message while a part of it waited.
    dropped_batches: int


@dataclass(frozen=True)
class Connection:
    """A connection of a robot's router."""

    #: Method of the link: `any`, `ble`, `tcp`, `udp` and so on.
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
    #: Time for which nothing has been received over the link, in seconds, if that is longer than usual: an idle link
    #: receives something every 2.5 s. `None` if the link is not silent, or its method is not `any` or `ble`.
    silent_s: float | None = None
    #: Batches and bytes sent: `{"batches": ..., "bytes": ...}`. `None` if they are not counted; `batches` is `None` if
    #: only bytes are counted.
    sent: dict[str, int | None] | None = None
    #: Batches and bytes received, in the same form.
    received: dict[str, int | None] | None = None
    #: Round trip, in milliseconds. `None` if it is not measured.
    round_trip_ms: float | None = None
    #: Received signal strength, in dBm. `None` if no signal was received within the last minute.
    rssi_dbm: int | None = None
    #: Whether the link is encrypted. `None` if that is not known.
    encrypted: bool | None = None
    #: Paths of the link, if its method is `any`.
    paths: list[LinkPath] | None = None
    #: How often the path that carries the bulk was replaced, if the method is `any`: by another one, or by itself after
    #: it had been silent.
    switches: int | None = None
    #: The last time it was: `{"previous": ..., "path": ..., "reason": ..., "gap_ms": ..., "ago_s": ...}`.
    last_switch: dict[str, Any] | None = None
    #: Lanes of the link that were used, the most urgent first, if its method is `any` or `ble`.
    lanes: list[LinkLane] | None = None
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
    return answer(session, robot, _rect.registry_query(session.key_space, robot, question, filter)).value


def configure(session: Session, robot: str, action: str, argument: str) -> None:
    """Adds or removes a connection of a robot's router."""
    answer(session, robot, _rect.registry_change(session.key_space, robot, action, argument))


def answer(session: Session, robot: str, driver: _rect.Driver) -> Payload:
    """Returns the answer of a robot's registry to a question of the core."""
    outcome, detail = Executor(session, driver).run()
    if outcome == "answer":
        return Payload(*detail)
    if outcome == "rejected":
        raise service_error(robot, Payload(*detail))
    if outcome == "timed_out":
        raise TimedOut(detail, _rect.QUERY_TIMEOUT_S)
    if outcome == "no_service":
        raise NoService(robot, *detail)
    session.check()
    raise Closed


def peers(session: Session) -> list[str]:
    """Returns the names of the other robots of the fleet that are reachable now, in order."""
    names: list[str] = Executor(session, _rect.peers_query(session.key_space)).run()
    session.check()
    return names


def servers(session: Session, topic: str, has_ended: bool = False) -> _rect.Servers:
    """Returns the robots whose catalogue lists the topic. Raises `Closed`.

    `has_ended`: they are asked a moment later, because a request has just ended.
    """
    query = session.catalogues.servers(session.key_space, topic, has_ended)
    found: _rect.Servers | None = Executor(session, query).run()
    session.check()
    if found is None:
        raise session.closed_error()
    return found


def wait(session: Session, driver: _rect.Driver, expected: Callable[[], str], timeout: float) -> None:
    """Runs a wait of the core. Raises `TimedOut`, whose text says what was expected, and `Closed`."""
    waited = Executor(session, driver).run()
    if waited == "timed_out":
        raise TimedOut(expected(), timeout)
    if waited == "closed":
        session.check()
        raise Closed


def report(session: Session) -> bytes:
    """Returns the connections of this robot's router, as its registry reports them."""
    robot = session.key_space.robot
    return answer(session, robot, _rect.registry_query(session.key_space, robot, "connections", "")).bytes


def connections(session: Session, robot: str, filter: str) -> Connections:
    """Returns those connections of a robot's router that `filter` selects."""
    return Connections(_connection(row) for row in query(session, robot, "connections", filter))


def _connection(row: Any) -> Connection:
    try:
        values = {field.name: row.get(field.name) for field in fields(Connection)}
        peer, paths, lanes = values.pop("peer"), values.pop("paths"), values.pop("lanes")
        return Connection(
            **values,
            peer=None if peer is None else Peer(peer["id"], peer.get("robot")),
            paths=None if paths is None else [_fields_of(LinkPath, path) for path in paths],
            lanes=None if lanes is None else [_fields_of(LinkLane, lane) for lane in lanes],
        )
    except (AttributeError, KeyError, TypeError) as error:
        text = f"the payload is not a list of connections in JSON: {error!r}"
        raise PayloadError(text, "read") from None


def _fields_of(kind: type[_Part], row: Any) -> _Part:
    return kind(**{field.name: row[field.name] for field in fields(kind)})


def _cell(value: object) -> str:
    return "" if value is None else html.escape(str(value))
