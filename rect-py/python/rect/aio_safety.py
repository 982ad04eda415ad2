"""The dead man's switch and the stop of the fleet for asyncio."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Callable
from typing import Any

from rect.choices import Confirmation
from rect.deadman import DeadmanExecutor
from rect.errors import TimedOut
from rect.message import Message
from rect.options import text
from rect.receive_queue import Ended
from rect.stop import FleetStop as BlockingFleetStop
from rect.stop import Stop, StopExecutor


class Deadman:
    """A dead man's switch; see `rect.Deadman`. Commands are carried out in the event loop."""

    def __init__(self, executor: DeadmanExecutor, drive: Callable[[Message[Any]], object]) -> None:
        self._executor = executor
        self._drive = drive

    @property
    def is_following(self) -> bool:
        """Whether the robot follows commands."""
        return self._executor.is_following

    def close(self) -> None:
        """Ends the switch, as a loss; see `rect.Deadman`."""
        self._executor.end()

    async def __aenter__(self) -> Deadman:
        return self

    async def __aexit__(self, *_: object) -> None:
        await asyncio.to_thread(self.close)

    def __repr__(self) -> str:
        return f"Deadman({self._executor.pattern}, is_following={self.is_following})"

    async def on_message(self, message: Message[Any]) -> None:
        """Carries out a command, if it counts."""
        # `begin` waits while `on_lost` is running.
        if await asyncio.to_thread(self._executor.begin, message):
            try:
                result = self._drive(message)
                if inspect.isawaitable(result):
                    await result
            finally:
                self._executor.finish()


class FleetStop:
    """The stop of the fleet; see `rect.FleetStop`."""

    def __init__(self, executor: StopExecutor) -> None:
        self._stop = BlockingFleetStop(executor)

    async def press(self, reason: str = "") -> None:
        """Stops the fleet, until somebody releases it; see `rect.FleetStop.press`."""
        await asyncio.to_thread(self._stop.press, text("reason", reason))

    async def release(self) -> None:
        """Releases all stops that this robot knows; see `rect.FleetStop.release`."""
        await asyncio.to_thread(self._stop.release)

    @property
    def is_stopped(self) -> bool:
        """Whether the fleet is stopped."""
        return self._stop.is_stopped

    @property
    def pressed(self) -> list[Stop]:
        """The stops that nobody has released, the latest first."""
        return self._stop.pressed

    def confirmation(self, robot: str) -> Confirmation | None:
        """Returns whether a robot has confirmed the stop, or its release; see `rect.FleetStop.confirmation`."""
        return self._stop.confirmation(robot)

    async def wait_for_change(self, timeout: float | None = None) -> None:
        """Waits for a stop, a release or a confirmation; see `rect.FleetStop.wait_for_change`."""
        try:
            await self._stop._changes.queue.pop_async(timeout)
        except Ended:
            raise self._stop._executor.closed_error() from None
        except TimeoutError:
            raise TimedOut("change of the stop", timeout or 0) from None

    def __repr__(self) -> str:
        return repr(self._stop)
