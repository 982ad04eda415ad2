"""Carries out the goals of an action: long tasks with progress, cancel and one end."""

from __future__ import annotations

import contextlib
import inspect
import logging
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Generic

from rect import _rect, action_result, stop
from rect.errors import Cancelled, Closed, NotRetained, OptionError, PayloadError, RectError
from rect.executor import Executor
from rect.options import seconds, text
from rect.receive_queue import Ended, ReceiveQueue
from rect.service import Refusal, Request, Requests, error_text, request_converter
from rect.subscriber import Subscription
from rect.typed import T
from rect.values import Payload, payload_of
from rect.waiting import next_wait

if TYPE_CHECKING:
    from rect.session import Session

Handler = Callable[["Goal[Any]"], Any]

_LOG = logging.getLogger("rect")
#: How long the end of a session waits for the ends of goals, in seconds.
_END_S = 1.0


class AnyGoal(Generic[T]):
    """A goal that a blocking or an asynchronous handler carries out."""

    def __init__(self, executor: ActionExecutor, id: str, value: T, by: str) -> None:
        self._executor = executor
        #: Closed when the handler should end.
        self._cancelled: ReceiveQueue[None] = ReceiveQueue(1, "drop_newest")
        self._reason: str | None = None
        #: Whether the handler knows that it should end.
        self.is_noticed = False
        #: The id, which its client has chosen.
        self.id = id
        #: The goal itself. `None` if its client has given none.
        self.value = value
        #: The program that has started it: `<robot>/<program>`. The name is not verified: do not base permissions on
        #: it.
        self.by = by

    def feedback(self, value: Any = None, *, progress: float | None = None) -> None:
        """Reports news to those who follow the goal: a value, and how much is done, from 0 to 1.

        The newest counts, and it is sent 10 times a second at most, without delaying anything else. Does not wait.

        Raises `PayloadError` if the value cannot be encoded, or has more than 48 kB.
        """
        self._executor.on_feedback(self.id, value, progress)

    @property
    def cancelled(self) -> bool:
        """Whether the handler should end: somebody has cancelled the goal, a newer one takes its place, its client has
        ended or cannot be reached, the fleet is stopped, or the action is closed.

        If the handler returns after this was true, the goal counts as cancelled, and otherwise as done.
        """
        return self.cancel_reason is not None

    @property
    def cancel_reason(self) -> str | None:
        """Why the handler should end; `None` while it should not."""
        if self._reason is not None:
            self.is_noticed = True
        return self._reason

    def check(self) -> None:
        """Raises `Cancelled` if the handler should end."""
        reason = self.cancel_reason
        if reason is not None:
            raise Cancelled(reason)

    def cancel(self, reason: str) -> None:
        """Asks the handler to end. Called by the action."""
        self._reason = reason
        self._cancelled.close()

    def __repr__(self) -> str:
        return f"Goal({self.id}, by={self.by})"


class Goal(AnyGoal[T]):
    """A goal that a handler carries out; see `Robot.action`. `Goal[Target]` has a `value` of the type `Target`."""

    def sleep(self, seconds: float) -> None:
        """Sleeps. Raises `Cancelled` as soon as the handler should end."""
        try:
            self._cancelled.pop(seconds)
        except Ended:
            self.check()
        except TimeoutError:
            return


class Action:
    """An action of this program. Returned by `Robot.action`. It ends when it or the robot is closed."""

    def __init__(self, executor: ActionExecutor, handler: Callable[..., Any]) -> None:
        self._executor = executor
        self._handler = handler
        executor.start(Goal, self._begin)

    def close(self) -> None:
        """Ends the action: no goal begins any more, and the one that runs is asked to end. Does not wait for that."""
        self._executor.end()

    def __enter__(self) -> Action:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __call__(self, goal: Goal[Any]) -> Any:
        """Calls the handler, so that a function decorated by `@robot.action` remains callable."""
        return self._handler(goal)

    def __repr__(self) -> str:
        return f"Action({self._executor.name})"

    def _begin(self, goal: Goal[Any]) -> None:
        """Begins a goal on a thread of its own."""

        def carry_out() -> None:
            try:
                result = self._handler(goal)
            except BaseException as error:
                # `sys.exit` included: it would end only this thread.
                self._executor.on_raised(goal, error)
            else:
                self._executor.on_returned(goal, result)

        threading.Thread(target=carry_out, name=f"rect {self._executor.name}", daemon=True).start()


class ActionExecutor:
    """Executes an action of the core: answers orders, runs the handler, and publishes the states of goals."""

    def __init__(
        self,
        session: Session,
        action: object,
        handler: object,
        about: str | None,
        when_busy: object,
        lost_after: object,
    ) -> None:
        session.check()
        self.name = text("action", action)
        topic = _rect.InternalTopic.of_action(self.name)
        if not callable(handler):
            raise TypeError(f"handler must be a function, not {type(handler).__name__}")
        if when_busy not in ("preempt", "refuse"):
            raise OptionError("when_busy", when_busy, 'it must be "preempt" or "refuse"')
        lost_after = None if lost_after is None else seconds("lost_after", lost_after)
        self._session = session
        self._converter = request_converter(handler, AnyGoal, "Goal")
        if about is None:
            about = (inspect.getdoc(handler) or "").partition("\n")[0]
        self._core = _rect.ActionServer(session.program.name, when_busy == "refuse", lost_after)
        self._goal: type[AnyGoal[Any]]
        self._run: Callable[[Any], None]
        self._goals: dict[str, AnyGoal[Any]] = {}
        self._orders: dict[int, Request[Any]] = {}
        self._number = 0
        self._works, self._publishes = threading.Event(), threading.Event()
        #: The goal and the feedback that is sent next; created with the thread that sends it.
        self._feedback: ReceiveQueue[tuple[str, Payload]] | None = None
        #: Whether no goal begins any more.
        self._is_closing = False
        self._is_ended = False
        self._finished = threading.Event()
        self._last_problem: str | None = None
        self._observer: Executor | None = None
        self._stops: Subscription[Any] | None = None
        # It knows of a stop before the first order.
        self._stop = stop.executor_of(session)
        self._requests = Requests(session, topic, None, about, False)

    def start(self, goal: type[AnyGoal[Any]], run: Callable[[Any], None]) -> None:
        """Begins to carry out goals, which have that class. `run` begins one, without waiting for its end."""
        session = self._session
        self._goal, self._run = goal, run
        session.handles.add(self)
        session.before_close.append(self.finish)
        try:
            _, earlier = goals_of(session, session.key_space.robot, self.name, "*")
            for message in earlier:
                self._core.on_earlier(message)
            changes = self._stop.changes()
            self._stops = Subscription(changes, lambda _: self._on_stop(), f"stop of {self.name}")
            self._on_stop()
            observer = _rect.observer(session.key_space, session.program.instance, session.is_direct)
            self._observer = Executor(session, observer, self._on_event, is_passive=True)
            self._observer.start("rect action events")
            session.start(f"rect {self.name} goals", self._work)
            session.start(f"rect {self.name} states", self._publish)
            threading.Thread(target=self._serve, name=f"rect {self.name} orders", daemon=True).start()
        except BaseException:
            self._is_ended = True
            self.end()
            raise

    def on_feedback(self, id: str, value: Any, progress: float | None) -> None:
        """Handles feedback of a handler. Raises `PayloadError`."""
        payload = payload_of(value)
        progress = None if progress is None else float(progress)
        self._core.on_feedback(id, payload.bytes, payload.encoding, progress)
        self._publishes.set()

    def on_returned(self, goal: AnyGoal[Any], result: Any) -> None:
        """Handles that a handler has returned."""
        try:
            payload = payload_of(result)
            self._core.on_done(goal.id, payload.bytes, payload.encoding, goal.is_noticed)
        except Exception as error:
            self._core.on_failed(goal.id, f"the result cannot be sent: {error_text(error)}")
        self._on_end(goal)

    def on_raised(self, goal: AnyGoal[Any], error: BaseException) -> None:
        """Handles that a handler has raised an exception. Logs it as a service does."""
        if isinstance(error, Cancelled) and goal.cancelled:
            self._core.on_cancelled(goal.id)
        else:
            if not isinstance(error, (Refusal, RectError)):
                _LOG.error("the handler of the action %s raised an exception", self.name, exc_info=error)
            self._core.on_failed(goal.id, failure(error))
        self._on_end(goal)

    def finish(self) -> None:
        """Ends the action, and waits a moment for the end of its goals."""
        self.end()
        if not self._is_ended:
            self._finished.wait(_END_S)

    def end(self) -> None:
        """Asks the goals to end, and begins no other ones."""
        if self._session.is_closed:
            self._is_ended = True
        if not self._is_closing:
            self._is_closing = True
            self._requests.close()
            self._core.close()
        self._wake()
        if self._is_ended:
            self._leave()

    def on_fork(self) -> None:
        """Ends the action in a child process, which has no thread of it."""
        self._is_closing = self._is_ended = True

    def _leave(self) -> None:
        """Ends what the action uses, after its last goal."""
        self._is_ended = True
        self._session.handles.discard(self)
        with contextlib.suppress(ValueError):
            self._session.before_close.remove(self.finish)
        if self._feedback is not None:
            self._feedback.close()
        if self._stops is not None:
            self._stops.close()
        if self._observer is not None:
            self._observer.end()
        self._finished.set()
        self._wake()

    def _wake(self) -> None:
        self._works.set()
        self._publishes.set()

    def _on_end(self, goal: AnyGoal[Any]) -> None:
        self._goals.pop(goal.id, None)
        self._wake()

    def _on_event(self, event: tuple[Any, ...]) -> None:
        self._core.on_event(event)
        self._works.set()

    def _on_stop(self) -> None:
        pressed = self._stop.core.pressed
        self._core.on_stop(pressed[0][3] if pressed else None)
        self._wake()

    def _serve(self) -> None:
        """Takes the orders of other programs."""
        with contextlib.suppress(Ended):
            while True:
                request = self._requests.next()
                try:
                    self._take(request)
                except Exception as error:
                    _LOG.warning("cannot take an order of the action %s: %s", self.name, error)
                    request.close()

    def _take(self, request: Request[Any]) -> None:
        payload = request.payload
        try:
            goal = _rect.goal_to_start(payload.bytes, payload.encoding)
            if goal is not None:
                self._value(Payload(*goal))
        except PayloadError as error:
            # It does not fit the type that the handler states.
            request.refuse(f"{self.name}: {error}")
            request.close()
            return
        self._number += 1
        self._orders[self._number] = request
        self._core.on_order(self._number, request.sender, payload.bytes, payload.encoding)
        self._wake()

    def _value(self, payload: Payload) -> Any:
        """Returns the value of a goal. Raises `PayloadError`."""
        return payload.value if self._converter is None else self._converter.convert(payload.value)

    def _work(self) -> None:
        while not self._is_ended:
            step, *of_step = self._core.work()
            if step == "reply":
                self._reply(*of_step)
            elif step == "run":
                self._begin(*of_step)
            elif step == "cancel":
                goal = self._goals.get(of_step[0])
                if goal is not None:
                    goal.cancel(of_step[1])
            elif self._works.wait(next_wait(of_step[0])):
                self._works.clear()
            # There may be something to publish now.
            self._publishes.set()

    def _reply(self, number: int, refused: str | None) -> None:
        request = self._orders.pop(number)
        try:
            if refused is None:
                request.reply("")
                request.finish()
            else:
                request.refuse(refused)
        except Exception as error:
            _LOG.warning("cannot send a reply: %s", error)
        request.close()

    def _begin(self, id: str, value: tuple[bytes, str], by: str) -> None:
        try:
            goal = self._goals[id] = self._goal(self, id, self._value(Payload(*value)), by)
            self._run(goal)
        except Exception as error:
            self._goals.pop(id, None)
            self._core.on_failed(id, f"the goal cannot begin: {error_text(error)}")

    def _publish(self) -> None:
        while not self._is_ended:
            step, *of_step = self._core.publication()
            try:
                if step == "state":
                    id, state, urgency = of_step
                    self._core.on_published(id, self._retain(id, Payload(*state), urgency))
                    self._wake()
                elif step == "keep":
                    action_result.keep(self._session, *of_step)
                elif step == "feedback":
                    id, feedback = of_step
                    self._send(id, Payload(*feedback))
                elif step == "forget":
                    self._session.state.forget(_rect.goal_topic(self.name, of_step[0]))
                elif self._is_closing and self._core.is_finished:
                    self._leave()
                elif self._publishes.wait(next_wait(of_step[0])):
                    self._publishes.clear()
            except Closed:
                return
            except RectError as error:
                self._warn(str(error))

    def _send(self, id: str, feedback: Payload) -> None:
        """Sends feedback on a thread of its own: a busy link blocks it, and states must not wait for that.

        The newest replaces one that waits.
        """
        if self._feedback is None:
            self._feedback = ReceiveQueue(1, "drop_oldest")
            self._session.start(f"rect {self.name} feedback", self._send_feedback)
        self._feedback.push((id, feedback))

    def _send_feedback(self) -> None:
        assert self._feedback is not None
        # The session or the action may be closed meanwhile.
        with contextlib.suppress(Ended, Closed):
            while True:
                id, feedback = self._feedback.pop()
                try:
                    self._session.publish(_rect.goal_feedback_topic(self.name, id), None, feedback, "bulk", None)
                except RectError as error:
                    self._session.check()
                    self._warn(str(error))

    def _retain(self, id: str, state: Payload, urgency: str) -> str | None:
        """Publishes the state of a goal. Returns the reason if nobody keeps it. Raises `Closed`."""
        try:
            self._session.state.retain(_rect.goal_topic(self.name, id), state, urgency, False)
        except Closed:
            raise
        except RectError as error:
            self._warn(str(error))
            return error.reason if isinstance(error, NotRetained) else str(error)
        self._last_problem = None
        return None

    def _warn(self, problem: str) -> None:
        if problem != self._last_problem:
            self._last_problem = problem
            self._session.warn(problem)


def goals_of(session: Session, robot: str, action: str, goal: str) -> tuple[list[str], list[_rect.GoalMessage]]:
    """Returns the robots that have answered, and the goals that they know. `*` stands for all.

    Raises `InvalidTopicError` and `Closed`.
    """
    query = _rect.goals_query(session.key_space, robot, action, goal, _rect.QUERY_TIMEOUT_S)
    answered, goals = Executor(session, query).run()
    session.check()
    return answered, goals


def failure(error: BaseException) -> str:
    """Returns the reason of a goal whose handler has raised an exception."""
    if isinstance(error, SystemExit):
        return error_text(error).replace("the service", "the handler", 1)
    return str(error.value) if isinstance(error, Refusal) else error_text(error)
