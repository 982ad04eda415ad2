"""Actions for asyncio."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

from rect import _rect
from rect.action import ActionExecutor, AnyGoal
from rect.action_run import AnyRun, Feedback
from rect.deadline import Deadline
from rect.errors import TimedOut
from rect.options import seconds
from rect.receive_queue import Ended
from rect.typed import T

#: Starts a task, for which the robot waits when it is closed.
Begin = Callable[[Awaitable[None]], Any]


class Goal(AnyGoal[T]):
    """A goal that a handler carries out in the event loop; see `rect.Goal`."""

    async def sleep(self, seconds: float) -> None:
        """Sleeps. Raises `Cancelled` as soon as the handler should end."""
        try:
            await self._cancelled.pop_async(seconds)
        except Ended:
            self.check()
        except TimeoutError:
            return


class Action:
    """An action of this program; see `rect.Action`. Its handler runs in the event loop."""

    def __init__(self, begin: Begin, executor: ActionExecutor, handler: Callable[..., Any]) -> None:
        self._begin_task = begin
        self._executor = executor
        self._handler = handler
        self._loop = asyncio.get_running_loop()
        executor.start(Goal, self._begin)

    def close(self) -> None:
        """Ends the action; see `rect.Action.close`."""
        self._executor.end()

    async def __aenter__(self) -> Action:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()

    def __call__(self, goal: Goal[Any]) -> Any:
        """Calls the handler, so that a function decorated by `@robot.action` remains callable."""
        return self._handler(goal)

    def __repr__(self) -> str:
        return f"Action({self._executor.name})"

    def _begin(self, goal: Goal[Any]) -> None:
        """Begins a goal in the event loop. Called on a thread of the action."""
        self._loop.call_soon_threadsafe(lambda: self._begin_task(self._carry_out(goal)))

    async def _carry_out(self, goal: Goal[Any]) -> None:
        try:
            result = self._handler(goal)
            if inspect.isawaitable(result):
                result = await result
        except Exception as error:
            self._executor.on_raised(goal, error)
        except asyncio.CancelledError:
            self._executor.on_raised(goal, RuntimeError("the task of the handler was cancelled"))
            raise
        except BaseException as error:
            # `sys.exit` ends the loop.
            self._executor.on_raised(goal, error)
            raise
        else:
            self._executor.on_returned(goal, result)


class AsyncRun(AnyRun[T]):
    """A goal that this program has started or found."""

    async def __aiter__(self) -> AsyncIterator[Feedback]:
        feed = self._following.feed(self)
        try:
            while True:
                yield await feed.queue.pop_async()
        except Ended:
            return
        finally:
            feed.close()

    async def cancel(self, timeout: float = _rect.DEFAULT_TIMEOUT_S) -> None:
        """Asks the robot to end the goal; see `rect.ActionRun.cancel`."""
        await asyncio.to_thread(self._following.cancel, seconds("timeout", timeout))

    async def result(self, timeout: float | None = None) -> T:
        """Waits until the goal ends, and returns its result; see `rect.ActionRun.result`."""
        deadline = Deadline(timeout)
        try:
            await self._following.ended.pop_async(timeout)
        except Ended:
            pass
        except TimeoutError:
            raise TimedOut(self._core.expected, timeout or 0) from None
        pull = self._following.pull(self)
        if pull is not None:
            try:
                await pull.ended.pop_async(deadline.remaining())
            except Ended:
                pass
            except TimeoutError:
                raise TimedOut(pull.expected, timeout or 0) from None
        value: T = self._following.result()
        return value
