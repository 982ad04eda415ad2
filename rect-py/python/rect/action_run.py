"""Starts goals of the actions of other programs, and follows them."""

from __future__ import annotations

import contextlib
import random
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any, Generic

from rect import _rect, registry
from rect.action import goals_of
from rect.action_result import ResultPull
from rect.advice import on_problem
from rect.choices import Phase
from rect.deadline import Deadline
from rect.declared import Declared
from rect.errors import ActionError, NoAction, NoGoal, NotReachable, PayloadError, RectError, ServiceError, TimedOut
from rect.executor import Executor
from rect.message import Message, utc
from rect.options import seconds, text
from rect.program import names_of
from rect.receive_queue import DEFAULT_CAPACITY, Ended, ReceiveQueue
from rect.request import RetriedRequest
from rect.subscriber import Subscriber, Subscription, decoded
from rect.typed import Converter, T, converter_of
from rect.values import Payload, payload_of
from rect.waiting import next_wait

if TYPE_CHECKING:
    from rect.session import Session


@dataclass(frozen=True)
class Feedback:
    """News of a goal."""

    #: The value; `None` if there is none.
    value: Any
    #: How much is done, from 0 to 1. `None` if the action does not say.
    progress: float | None


@dataclass(frozen=True)
class KnownGoal:
    """A goal that a robot knows."""

    #: Name of the robot.
    robot: str
    #: Name of the action.
    action: str
    #: Id of the goal.
    id: str
    #: How far it has come. A goal whose program has ended is lost.
    phase: Phase
    #: Why it has ended, or is asked to; empty if that is clear.
    reason: str
    #: The program that has started it: `<robot>/<program>`.
    by: str
    #: The program that carries it out; empty if it has no name.
    program: str
    #: The goal itself. `None` if it is not known, since it is longer than 2 kB.
    goal: Any
    #: The result; `None` if there is none, or it has more than 48 kB: `Robot.find(...).result()` returns it.
    result: Any
    #: When it was started, by the clock of the robot, in UTC. The clock of a robot without a real-time clock may be
    #: years off.
    began: datetime
    #: When it ended; `None` if it has not.
    ended: datetime | None
    #: For how long the robot's router has known this state, in seconds: how long ago it began or ended, whatever the
    #: clock of the robot says.
    age: float


class AnyRun(Generic[T]):
    """A goal that a blocking or an asynchronous program follows."""

    def __init__(self, following: Following) -> None:
        self._following = following
        self._core = following.core
        following.declared.leave_with(self, following.leave)

    @property
    def id(self) -> str:
        """The id of the goal."""
        return self._core.id

    @property
    def robot(self) -> str:
        """Name of the robot that carries it out."""
        return self._core.robot

    @property
    def action(self) -> str:
        """Name of the action."""
        return self._core.action

    @property
    def phase(self) -> Phase:
        """How far the goal has come: `waiting`, `running`, `cancelling`, or how it has ended: `done`, `refused`,
        `failed`, `cancelled`, `preempted` or `lost`.

        `lost`: the program that carried it out has ended. The goal goes on while the robot cannot be reached; see
        `unreachable_for`.
        """
        return self._core.phase

    @property
    def phase_for(self) -> float:
        """For how long the goal has been in this phase, in seconds."""
        return self._core.phase_for

    @property
    def has_ended(self) -> bool:
        """Whether the goal has ended."""
        return self._core.has_ended

    @property
    def reason(self) -> str:
        """Why the goal has ended, or is asked to; empty if that is clear."""
        return self._core.reason

    @property
    def feedback(self) -> Feedback | None:
        """The newest feedback; `None` if there was none.

        Raises `PayloadError` if its value does not fit the type that `start` states.
        """
        return self._following.feedback()

    @property
    def progress(self) -> float | None:
        """How much is done, from 0 to 1. `None` if that is not known."""
        feedback = self._core.feedback
        return None if feedback is None else feedback[1]

    @property
    def is_reachable(self) -> bool:
        """Whether the robot can be reached."""
        return self._core.unreachable_for is None

    @property
    def unreachable_for(self) -> float | None:
        """For how long the robot cannot be reached, in seconds. `None` if it can be, or the goal has ended."""
        return self._core.unreachable_for

    def close(self) -> None:
        """Ends the following. The goal goes on."""
        self._following.end()

    def __repr__(self) -> str:
        return f"ActionRun({self.robot}, {self.action}, {self.id}, {self.phase})"


class ActionRun(AnyRun[T]):
    """A goal that this program has started or found. Returned by `Robot.start` and `Robot.find`.

    Closing it, or no longer using it, ends only the following: the goal goes on, and `Robot.find` finds it again.
    """

    def on_feedback(self, callback: Callable[[Feedback], object]) -> Subscription[Feedback]:
        """Calls `callback` with each `Feedback` until the goal ends, one call at a time, on a separate thread.

        The first one is the newest that has arrived already. An exception of the callback is logged.
        """
        if not callable(callback):
            raise TypeError(f"callback must be a function, not {type(callback).__name__}")
        return Subscription(self._following.feed(self), callback, f"feedback of {self.action}")

    def __iter__(self) -> Iterator[Feedback]:
        """Iterates over the feedback until the goal ends, beginning with the newest that has arrived already."""
        return iter(self._following.feed(self))

    def cancel(self, timeout: float = _rect.DEFAULT_TIMEOUT_S) -> None:
        """Asks the robot to end the goal, and returns when it has received that. The handler may take a while.

        Nothing happens if the goal has ended. `timeout`: how long to try, in seconds; the default is 10.

        Raises `TimedOut` if the robot did not answer, `NoAction`, `Interrupted`, `ServiceError` and `Closed`.
        """
        self._following.cancel(seconds("timeout", timeout))

    def result(self, timeout: float | None = None) -> T:
        """Waits until the goal ends, and returns its result: what the handler has returned.

        `timeout` is in seconds; `None`, the default, waits without limit.

        Raises `ActionError` if the goal was not done, with its `phase` and `reason`; `TimedOut` if it has not ended in
        time: it goes on; `PayloadError` if the result does not fit the type that `start` states; and `Closed`.

        A result of more than 48 kB is received from the program that has carried out the goal, which has to run until
        then: otherwise the `phase` of the `ActionError` is `done`. `TimedOut` says how much has arrived; the next call
        goes on with that.
        """
        deadline = Deadline(timeout)
        try:
            self._following.ended.pop(timeout)
        except Ended:
            pass
        except TimeoutError:
            raise TimedOut(self._core.expected, timeout or 0) from None
        pull = self._following.pull(self)
        if pull is not None:
            try:
                pull.ended.pop(deadline.remaining())
            except Ended:
                pass
            except TimeoutError:
                raise TimedOut(pull.expected, timeout or 0) from None
        value: T = self._following.result()
        return value

    def __enter__(self) -> ActionRun[T]:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Feed:
    """The feedback for one callback or iteration."""

    _HANDLE = "feedback"

    def __init__(self, session: Session, run: object) -> None:
        self._session = session
        #: The goal is followed while somebody gets its feedback.
        self._run = run
        self.queue: ReceiveQueue[Feedback] = ReceiveQueue(DEFAULT_CAPACITY, "drop_oldest")

    def __iter__(self) -> Iterator[Feedback]:
        try:
            while True:
                yield self.queue.pop()
        except Ended:
            return

    @property
    def dropped(self) -> int:
        """Number of feedbacks dropped because the queue was full."""
        return self.queue.dropped

    def close(self) -> None:
        """Ends it. Feedback that waits is still delivered."""
        self.queue.close()


class Following:
    """Executes the following of a goal by the core: receives its states and feedback, and asks its robot."""

    def __init__(self, session: Session, core: _rect.ActionRun, subscriber: Subscriber[Any], types: Types) -> None:
        self.core = core
        #: Closed when the goal, or the following, has ended.
        self.ended: ReceiveQueue[None] = ReceiveQueue(1, "drop_newest")
        self._session = session
        self._types = types
        self._feeds: list[Feed] = []
        self._lock = threading.Lock()
        #: The result, if it has more than 48 kB and the program waits for it.
        self._pull: ResultPull | None = None
        self._is_closed = False
        #: Wakes the thread that asks.
        self._wake = threading.Event()
        self._subscriber = subscriber
        self._observer: Executor | None = None
        self._is_ended = False
        self.declared = Declared(session, self.ended, self._on_end)

    def start(self, found: _rect.GoalMessage | None = None) -> None:
        """Begins to follow the goal, which was accepted, or `found`."""
        session, core = self._session, self.core
        if found is not None:
            core.on_answer(found)
        if self._end_if_over():
            return
        try:
            observer = _rect.observer(session.key_space, session.program.instance, session.is_direct)
            self._observer = Executor(session, observer, self._on_event, is_passive=True)
            self._observer.start("rect run events")
            Subscription(self._subscriber, self._on_message, f"goal of {core.action}")
            session.start(f"rect {core.action} state", self._ask)
        except BaseException:
            self.end()
            raise

    def feedback(self) -> Feedback | None:
        """Returns the newest feedback."""
        feedback = self.core.feedback
        return None if feedback is None else self._feedback(*feedback)

    def feed(self, run: object) -> Feed:
        """Returns the feedback from now on, for a callback or iteration."""
        feed = Feed(self._session, run)
        with self._lock:
            with contextlib.suppress(PayloadError):
                newest = self.feedback()
                if newest is not None:
                    feed.queue.push(newest)
            self._feeds.append(feed)
        if self._is_ended:
            feed.close()
        return feed

    def cancel(self, timeout: float) -> None:
        """Asks the robot to end the goal. Raises the errors of `ActionRun.cancel`."""
        self._session.check()
        if not self.core.has_ended:
            order = _rect.ActionOrder.cancel(self.core.id, self._session.program.name)
            give_order(self._session, self.core.robot, self.core.action, order, "urgent", timeout)

    def result(self) -> Any:
        """Returns the result of the goal. Raises `ActionError`, `PayloadError` and `Closed`."""
        core = self.core
        if not core.has_ended:
            raise self._session.closed_error("run")
        if self._pull is not None:
            result = self._pull.value()
        else:
            result = None if core.result is None else Payload(*core.result).value
        if core.phase != "done":
            raise ActionError(core.phase, core.reason, result)
        return self._types.result_of(result)

    def pull(self, run: object) -> ResultPull | None:
        """Begins to receive a large result, or goes on with that, until the end of `run`. `None` if it is not large.

        Raises `ActionError` if it cannot be received, `ThreadError` and `Closed`.
        """
        with self._lock:
            if self._pull is None or self._pull.has_failed:
                core = self.core.pull(self._session.key_space)
                if core is not None:
                    self._session.check()
                    if self._is_closed:
                        raise self._session.closed_error("run")
                    self._pull = ResultPull(self._session, core, run)
            return self._pull

    def end(self) -> None:
        """Ends the following."""
        self._is_closed = True
        if self._pull is not None:
            self._pull.stop()
        self.declared.end()

    def leave(self) -> None:
        """Ends the following of a handle that was garbage-collected, without blocking."""
        self.declared.leave()

    def _feedback(self, value: tuple[bytes, str], progress: float | None) -> Feedback:
        return Feedback(self._types.feedback_of(Payload(*value)), progress)

    def _on_message(self, message: Message[Any]) -> None:
        payload = decoded(self._session, message, None).payload
        feedback = self.core.on_message(message._metadata, payload.bytes, payload.encoding)
        if feedback is not None:
            self._give(*feedback)
        self._wake.set()
        self._end_if_over()

    def _give(self, value: tuple[bytes, str], progress: float | None) -> None:
        """Gives feedback to callbacks and iterations."""
        try:
            news = self._feedback(value, progress)
        except PayloadError as error:
            on_problem(self._session, self.core.robot, f"feedback of {self.core.action}", error)
            return
        with self._lock:
            for feed in self._feeds:
                feed.queue.push(news)

    def _on_event(self, event: tuple[Any, ...]) -> None:
        self.core.on_event(event)
        self._wake.set()

    def _ask(self) -> None:
        """Asks the robot for the state whenever the core does."""
        core = self.core
        while not self._is_ended:
            if not core.asks():
                self._wake.wait(next_wait(core.wait()))
                self._wake.clear()
                continue
            try:
                answered, goals = goals_of(self._session, core.robot, core.action, core.id)
            except RectError:
                # The session is closed, or Zenoh cannot ask now.
                core.on_no_answer()
                continue
            if core.robot in answered:
                core.on_answer(goals[0] if goals else None)
            else:
                core.on_no_answer()
            self._end_if_over()

    def _end_if_over(self) -> bool:
        """Ends the following of a goal that has ended."""
        if self.core.has_ended:
            self.declared.end()
        return self.core.has_ended

    def _on_end(self) -> None:
        self._is_ended = True
        with self._lock:
            feeds, self._feeds = self._feeds, []
        for feed in feeds:
            feed.close()
        self._wake.set()
        self._subscriber.close()
        if self._observer is not None:
            self._observer.end()


class Types:
    """The types of the result and the feedback of a goal that the program states."""

    def __init__(self, result: Any, feedback: Any) -> None:
        """Raises `TypeError` if values cannot be converted to a type."""
        self._result: Converter[Any] | None = converter_of(result)
        self._feedback: Converter[Any] | None = converter_of(feedback)

    def result_of(self, value: Any) -> Any:
        """Returns a result as its type. Raises `PayloadError`."""
        return value if self._result is None else self._result.convert(value)

    def feedback_of(self, payload: Payload) -> Any:
        """Returns the value of feedback as its type; `None` if there is none. Raises `PayloadError`."""
        value = payload.value
        if self._feedback is not None and value is not None:
            return self._feedback.convert(value)
        return value


def start(
    session: Session,
    robot: str,
    action: str,
    goal: Any,
    id: str | None,
    feedback_per_s: float | None,
    timeout: float,
    types: Types,
) -> Following:
    """Starts a goal. Raises the errors of `Robot.start`."""
    session.check()
    goal_id = _rect.goal_id(random.getrandbits(64)) if id is None else text("id", id)
    payload = payload_of(goal)
    text("robot", robot)
    program = session.program.name
    _rect.InternalTopic.of_action(text("action", action))
    order = _rect.ActionOrder.start(goal_id, payload.bytes, payload.encoding, program, feedback_per_s)
    timeout = seconds("timeout", timeout)
    # The first feedback arrives, too.
    subscriber = _subscriber(session, robot, action, goal_id)
    try:
        give_order(session, robot, action, order, "normal", timeout)
        core = _rect.ActionRun(robot, action, goal_id)
    except ServiceError as refused:
        reason = refused.value if isinstance(refused.value, str) else str(refused)
        core = _rect.ActionRun(robot, action, goal_id, reason)
    except BaseException:
        subscriber.close()
        raise
    following = Following(session, core, subscriber, types)
    following.start()
    return following


def find(session: Session, robot: str, action: str, id: str, types: Types) -> Following:
    """Finds a goal. Raises the errors of `Robot.find`."""
    session.check()
    for name, value in (("robot", robot), ("action", action), ("id", id)):
        text(name, value)
    # Neither of them is a pattern.
    _rect.InternalTopic.of_action(action)
    _rect.ActionOrder.start(id, b"", "", None, None)
    answered, goals = goals_of(session, robot, action, id)
    if not goals:
        if robot in answered:
            raise NoGoal(robot, action, id)
        peers = registry.peers(session)
        if robot in peers or robot == session.key_space.robot:
            raise TimedOut(f"answer of {robot}", _rect.QUERY_TIMEOUT_S)
        raise NotReachable(robot, peers)
    subscriber = _subscriber(session, robot, action, id)
    following = Following(session, _rect.ActionRun(robot, action, id), subscriber, types)
    following.start(goals[0])
    return following


def _subscriber(session: Session, robot: str, action: str, id: str) -> Subscriber[Any]:
    """Subscribes to the states and the feedback of a goal."""
    pattern = f"{robot}/{_rect.goal_topic(action, id)}/**"
    inbound = _rect.Inbound(session.key_space, pattern)
    return Subscriber(session, inbound, pattern, None, DEFAULT_CAPACITY, "drop_oldest")


def goals(session: Session, robot: str) -> list[KnownGoal]:
    """Returns the goals that robots know, by robot and age. Raises the errors of `Robot.goals`."""
    session.check()
    _, found = goals_of(session, text("robot", robot), "*", "*")
    known = [_known(*parts) for message in found if (parts := message.goal()) is not None]
    return sorted(known, key=lambda goal: (goal.robot, goal.began, goal.id))


def _known(
    which: tuple[str, str, str],
    phase: tuple[Phase, str],
    values: tuple[tuple[bytes, str] | None, tuple[bytes, str] | None],
    programs: tuple[str, str],
    times: tuple[int, int | None, float],
) -> KnownGoal:
    result, goal = (None if value is None else Payload(*value).value for value in values)
    began, ended = (None if ms is None else utc(ms / 1000) for ms in times[:2])
    assert began is not None
    return KnownGoal(*which, *phase, *programs, goal, result, began, ended, times[2])


def give_order(
    session: Session, robot: str, action: str, order: _rect.ActionOrder, urgency: str, timeout: float
) -> None:
    """Gives an order to an action, and waits until it is accepted.

    Raises `ServiceError` if it is refused, `NoAction`, `Interrupted`, `TimedOut` and `Closed`.
    """
    topic = _rect.InternalTopic.of_action(action)
    payload = Payload(*order.payload())
    until = time.monotonic() + _rect.DECLARED_WITHIN_S
    while True:
        request: RetriedRequest[Any] = RetriedRequest(session, robot, topic, payload, urgency, timeout, None)
        if request.run() is not None:
            return
        # An action that was just declared may be in the catalogue before it can be reached.
        actions = names_of(session, robot, lambda program: program.actions)
        if action not in actions or time.monotonic() >= until:
            raise NoAction(robot, action, actions)
        time.sleep(_rect.DECLARED_PAUSE_S)
