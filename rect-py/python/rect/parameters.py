"""Keeps a group of parameters of this program: serves changes, publishes the values, and stores them."""

from __future__ import annotations

import contextlib
import logging
import os
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Optional, TypeVar, Union

from rect import _rect
from rect.errors import Closed, ParameterError, RectError
from rect.options import text
from rect.parameter_types import Declared, declaration_of
from rect.receive_queue import DEFAULT_CAPACITY, Ended, ReceiveQueue
from rect.service import Refusal, Request, Requests, error_text
from rect.subscriber import Subscription
from rect.values import Payload

if TYPE_CHECKING:
    from rect.session import Session

_LOG = logging.getLogger("rect")


@dataclass(frozen=True)
class GroupOptions:
    """The options of a group of parameters, for `Robot.parameters`."""

    #: The purpose of the group: at most 200 characters.
    about: str = ""
    #: The file in which the values are kept. `None`: `<folder>/<robot>/<group>.json`, in the folder of the environment
    #: variable `RECT_PARAMETERS`, or `~/.local/state/rect/parameters`. `False`: none, so that the program begins with
    #: the defaults at each start.
    file: str | os.PathLike[str] | Literal[False] | None = None
    #: A check of changes, as `ParameterGroup.check` adds one: this one is there before the first change can arrive.
    check: Callable[[dict[str, Any]], str | None] | None = None


@dataclass(frozen=True)
class ParameterChange:
    """A change of parameters. Those that are changed together are one change."""

    #: Name, old value and new value of each parameter that has another value now.
    changed: list[tuple[str, Any, Any]]
    #: The program that has changed them, `<robot>/<program>`, or its robot; empty if it was this program itself.
    by: str


#: A function that gets the values as they would be, and returns the reason why it refuses them, or `None`.
Check = Callable[[dict[str, Any]], Optional[str]]
OnChange = Callable[[ParameterChange], object]
C = TypeVar("C", bound=Union[Check, OnChange])
CheckT = TypeVar("CheckT", bound=Check)
OnChangeT = TypeVar("OnChangeT", bound=OnChange)


class ParameterGroup:
    """A group of parameters of this program, which are its attributes. Returned by `Robot.parameters`.

    It ends when it or the robot is closed, and stores then what has changed. Its last values remain visible.
    """

    __slots__ = ("_executor",)
    _executor: GroupExecutor

    def __init__(self, executor: GroupExecutor) -> None:
        self._executor = executor

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return self._executor.core.value(name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name.startswith("_"):
            object.__setattr__(self, name, value)
            return
        if name in _METHODS:
            raise AttributeError(f"{name} is a method of the group")
        # Raises `AttributeError` if there is no such parameter.
        self._executor.core.value(name)
        self.set({name: value})

    def __dir__(self) -> list[str]:
        return [*object.__dir__(self), *self._executor.core.names()]

    def values(self) -> dict[str, Any]:
        """Returns the values of all parameters. They belong together: a change is in all of them or in none."""
        return self._executor.core.values()

    def set(self, values: Mapping[str, Any] | None = None, /, **more: Any) -> None:
        """Changes parameters, also read-only ones: all or none.

        They are in force when this method returns, and are published and stored in the background.

        Raises `ParameterError` with the reason if a value is refused, and `Closed`.
        """
        self._executor.change_own(_rect.ParameterOrder({**(values or {}), **more}, False))

    def reset(self, *names: str) -> None:
        """Gives these parameters their defaults, also read-only ones. Without names: all of them.

        Raises `ParameterError` if there is no such parameter or the defaults are refused, and `Closed`.
        """
        self._executor.change_own(_rect.ParameterOrder({}, names or True))

    def check(self, callback: CheckT) -> CheckT:
        """Calls `callback` before each change, with a dict of all values as they would be.

        The callback refuses the change by raising `rect.Refusal("the reason")`, or by returning the reason. It must not
        change parameters itself. It is called on the thread of the program that changes them, or on one for the changes
        of others. This method is also a decorator. Raises `Closed`.
        """
        self._executor.add_check(callback)
        return callback

    def on_change(self, callback: OnChangeT) -> OnChangeT:
        """Calls `callback` after each change with a `ParameterChange`, one call at a time and in order, on a separate
        thread. This method is also a decorator.

        An exception of the callback is logged (`logging.getLogger("rect")`). If 256 changes wait, the one that has
        waited longest is dropped. Raises `Closed`.
        """
        Subscription(self._executor.changes(callback), callback, f"changes of {self._executor.name}")
        return callback

    def close(self) -> None:
        """Ends the group, and stores what has changed."""
        self._executor.end()

    def __enter__(self) -> ParameterGroup:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"ParameterGroup({self._executor.name})"


#: Names that a parameter cannot have, because the group uses them.
_METHODS = frozenset(name for name in dir(ParameterGroup) if not name.startswith("_"))


class Changes:
    """The changes for one callback."""

    _HANDLE = "group"

    def __init__(self, session: Session) -> None:
        self._session = session
        self.queue: ReceiveQueue[ParameterChange] = ReceiveQueue(DEFAULT_CAPACITY, "drop_oldest")

    def __iter__(self) -> Iterator[ParameterChange]:
        with contextlib.suppress(Ended):
            while True:
                yield self.queue.pop()

    @property
    def dropped(self) -> int:
        """Number of changes dropped because the queue was full."""
        return self.queue.dropped

    def close(self) -> None:
        """Ends it. Changes that wait are still delivered."""
        self.queue.close()


class GroupExecutor:
    """Executes a group of the core: carries out orders, publishes the values and stores them."""

    def __init__(self, session: Session, group: str, options: GroupOptions, parameters: Mapping[str, Declared]) -> None:
        for name in parameters:
            if name.startswith("_") or name in _METHODS:
                reason = "the group has an attribute of that name" if name in _METHODS else "it begins with `_`"
                raise ParameterError(f"{name} cannot be the name of a parameter in Python: {reason}")
        declaration = declaration_of(parameters)
        topic = _rect.InternalTopic.of_parameters(group)
        if options.check is not None and not callable(options.check):
            raise TypeError(f"check must be a function, not {type(options.check).__name__}")
        self.name = group
        self._session = session
        self.requests = Requests(session, topic, None, options.about, False, declaration)
        try:
            self.core, warnings = _rect.ParameterGroup.open(declaration, self._file(options))
            for warning in warnings:
                session.warn(warning)
            self._checks: list[Check] = [] if options.check is None else [options.check]
            self._changes: list[Changes] = []
            #: Held from the proposal of a change until it is in force.
            self._turn = threading.Lock()
            #: The thread that checks a change.
            self._checking: int | None = None
            #: Orders that wait until the values of a revision are stored.
            self._unconfirmed: list[tuple[Request[Any], int]] = []
            self._confirming = threading.Lock()
            self._wake = threading.Event()
            self._is_ended = False
            self._last_problem: str | None = None
            session.handles.add(self)
            session.start(f"rect {group} values", self._publish_and_store)
        except BaseException:
            self.requests.close()
            raise

    def serve(self) -> None:
        """Carries out the orders of other programs on a thread, one after the other."""

        def serve() -> None:
            with contextlib.suppress(Ended):
                while True:
                    self._answer(self.requests.next())

        threading.Thread(target=serve, name=f"rect {self.name}", daemon=True).start()

    async def serve_async(self) -> None:
        """Does the same as `serve`, for asyncio."""
        with contextlib.suppress(Ended):
            while True:
                self._answer(await self.requests.next_async())

    def change_own(self, order: _rect.ParameterOrder) -> None:
        """Carries out an order of the program itself. Raises `ParameterError` and `Closed`."""
        self._change(order, None)

    def add_check(self, callback: Check) -> None:
        """Adds a function that checks changes. Raises `Closed`."""
        self._checks.append(self._callable(callback))

    def changes(self, callback: OnChange) -> Changes:
        """Returns the changes from now on, for a callback. Raises `Closed`."""
        self._callable(callback)
        changes = Changes(self._session)
        self._changes.append(changes)
        return changes

    def end(self) -> None:
        """Ends the group, and stores what has changed."""
        if self._is_ended:
            return
        self._is_ended = True
        self._session.handles.discard(self)
        self.requests.close()
        for changes in self._changes:
            changes.close()
        self._wake.set()
        self._save()

    def on_fork(self) -> None:
        """Ends the group in a child process: the file belongs to the parent."""
        self._is_ended = True

    def _file(self, options: GroupOptions) -> str | os.PathLike[str] | None:
        if options.file is not None:
            return options.file or None
        path = _rect.parameters_file(self._session.key_space.robot, self.name)
        if path is None:
            self._session.warn(
                f"the parameters {self.name} are not kept: there is no folder for them. Set RECT_PARAMETERS to one, or "
                "name a file"
            )
        return path

    def _callable(self, callback: C) -> C:
        if not callable(callback):
            raise TypeError(f"callback must be a function, not {type(callback).__name__}")
        if self._is_ended:
            raise self._session.closed_error("group")
        return callback

    def _change(self, order: _rect.ParameterOrder, robot: str | None) -> tuple[Payload, int]:
        """Carries out an order of a robot, or of the program itself (`None`). Returns the reply, and the number of the
        change. Raises `ParameterError` and `Closed`."""
        if self._is_ended:
            raise self._session.closed_error("group")
        if self._checking == threading.get_ident():
            raise ParameterError("a check cannot change parameters")
        with self._turn:
            proposal = self.core.propose(order, robot is None)
            self._check(proposal)
            change = self.core.commit(proposal, robot)
            reply = Payload(*self.core.in_force(proposal)), self.core.revision
            if change is not None:
                for changes in self._changes:
                    changes.queue.push(ParameterChange(*change))
        if change is not None:
            self._wake.set()
            if self._is_ended:
                # The group has ended meanwhile, and may have stored the values before.
                self._save()
        return reply

    def _check(self, proposal: _rect.ParameterProposal) -> None:
        """Lets the program check a change. Raises `ParameterError` with its reason."""
        self._checking = threading.get_ident()
        try:
            for check in self._checks:
                reason = check(self.core.proposed(proposal))
                if isinstance(reason, str):
                    raise ParameterError(reason)
                if reason is not None:
                    raise TypeError(f"a check returns the reason of a refusal or None, not {type(reason).__name__}")
        except ParameterError:
            raise
        except Refusal as refusal:
            raise ParameterError(str(refusal.value)) from refusal
        except Exception as error:
            raise ParameterError(f"the check of the program failed: {error_text(error)}") from error
        finally:
            self._checking = None

    def _answer(self, request: Request[Any]) -> None:
        """Carries out the order of another program."""
        try:
            try:
                order = _rect.ParameterOrder.read(request.payload.bytes, request.payload.encoding)
                reply, revision = self._change(order, request.sender or "a Zenoh program")
            except BaseException as error:
                # `sys.exit` included: it would end only this thread, and nobody could change the parameters any more.
                if error.__cause__ is not None and not isinstance(error.__cause__, Refusal):
                    _LOG.error("a check of the parameters %s raised an exception", self.name, exc_info=error.__cause__)
                request.refuse_for(error)
            else:
                request.reply(reply)
                if order.stored:
                    with self._confirming:
                        self._unconfirmed.append((request, revision))
                    self._confirm()
                    return
                request.finish()
        except Exception as error:
            _LOG.warning("cannot send a reply: %s", error)
        request.close()

    def _confirm(self) -> None:
        """Sends the second replies to the orders whose values are stored, or could not be."""
        with self._confirming:
            waiting, self._unconfirmed = self._unconfirmed, []
            for request, revision in waiting:
                stored = self.core.stored(revision)
                if stored is None:
                    self._unconfirmed.append((request, revision))
                    continue
                # An error means that the session is closed.
                with contextlib.suppress(RectError):
                    request.reply(Payload(*stored))
                    request.finish()
                request.close()

    def _publish_and_store(self) -> None:
        while not self._is_ended:
            work, values, seconds = self.core.work()
            if values is not None:
                self._publish(Payload(*values))
            elif work == "save":
                self._save()
            else:
                self._wake.wait(seconds)
                self._wake.clear()

    def _publish(self, values: Payload) -> None:
        try:
            self._session.state.retain(_rect.parameters_topic(self.name), values, "normal", False)
            self._last_problem = None
        except Closed:
            # The session ends the group.
            return
        except RectError as error:
            if str(error) != self._last_problem:
                self._last_problem = str(error)
                self._session.warn(self._last_problem)
            self.core.on_not_published()

    def _save(self) -> None:
        """Stores the values, if they have changed."""
        self._session.warn(self.core.save())
        self._confirm()


def executor_of(session: Session, group: object, options: object, parameters: Mapping[str, Declared]) -> GroupExecutor:
    """Declares a group of parameters. Raises `ParameterError`, `ServiceRefused`, `Closed` and `TypeError`."""
    session.check()
    options = GroupOptions() if options is None else options
    if not isinstance(options, GroupOptions):
        raise TypeError(f"the options of a group must be rect.GroupOptions, not {type(options).__name__}")
    return GroupExecutor(session, text("group", group), options, parameters)
