"""Changes the parameters of programs."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rect import _rect
from rect.errors import Interrupted, NoParameters, NoService, NotStored
from rect.program import names_of
from rect.request import Replies
from rect.values import Payload

if TYPE_CHECKING:
    from rect.session import Session


def set_parameters(
    session: Session, robot: str, group: str, values: Mapping[str, Any], reset: bool | Sequence[str], stored: bool
) -> dict[str, Any]:
    """Changes parameters of a program of a robot. Returns the values that are in force.

    Raises the errors of `Robot.set_parameters`.
    """
    is_list = isinstance(reset, Sequence) and not isinstance(reset, str)
    if not isinstance(reset, bool) and not is_list:
        raise TypeError(f"reset must be True or a list of names, not {type(reset).__name__}")
    topic = _rect.InternalTopic.of_parameters(group)
    order = _rect.ParameterOrder(dict(values), reset, stored, session.program.name)
    timeout = _rect.DEFAULT_TIMEOUT_S
    payload = Payload(*order.payload())
    until = time.monotonic() + _rect.DECLARED_WITHIN_S
    while True:
        replies: Replies[Any] = Replies(session, robot, topic, payload, "normal", timeout, None, is_stream=stored)
        try:
            in_force = _next(replies)
            if stored:
                confirmation = _next(replies)
                if not confirmation["stored"]:
                    raise NotStored(robot, confirmation.get("reason", ""))
            return dict(in_force["values"])
        except NoService:
            # A group that was just declared may be in the catalogue before it can be reached.
            groups = names_of(session, robot, lambda program: program.parameters)
            if group not in groups or time.monotonic() >= until:
                raise NoParameters(robot, group, groups) from None
        except Interrupted:
            # A group that was declared while the order was in flight, or whose program was started again. An order that
            # is carried out twice leaves the same values.
            if time.monotonic() >= until:
                raise
        finally:
            replies.leave()
        time.sleep(_rect.DECLARED_PAUSE_S)


def _next(replies: Replies[Any]) -> Any:
    for reply in replies:
        return reply.value
    raise replies.unanswered(list)
