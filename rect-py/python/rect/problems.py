"""Counts the values that do not fit their type, and warns of them once for each sender and topic."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rect import _rect

_LOG = logging.getLogger("rect")
#: For how many topics of senders a warning is remembered; there are none for further ones.
_MAX_WARNED = 1000


class Problems:
    """The problems of one program."""

    def __init__(self, counters: _rect.AtomicCounters) -> None:
        self._counters = counters
        self._lock = threading.Lock()
        self._warned: set[tuple[str, str]] = set()

    def on_problem(self, sender: str, topic: str, problem: Exception) -> None:
        """Counts the problem of a message or request, and warns of the first one of this sender and topic."""
        self._counters.on_problem()
        with self._lock:
            is_known = (sender, topic) in self._warned or len(self._warned) >= _MAX_WARNED
            if not is_known:
                self._warned.add((sender, topic))
        if not is_known:
            _LOG.warning("%s of %s: %s", topic, sender, problem)
