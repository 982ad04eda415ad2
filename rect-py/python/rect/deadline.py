"""Defines the end of a wait that consists of several ones."""

from __future__ import annotations

import time

from rect.options import seconds


class Deadline:
    """The end of a wait that consists of several ones. `timeout` is in seconds; `None` means without limit."""

    def __init__(self, timeout: float | None) -> None:
        self._at = None if timeout is None else time.monotonic() + seconds("timeout", timeout)

    def remaining(self) -> float | None:
        """Returns the remaining seconds; `None` means without limit."""
        return None if self._at is None else max(0.0, self._at - time.monotonic())
