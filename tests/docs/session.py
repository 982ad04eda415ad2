"""Runs the commands of a page, as a user would in several terminals.

The page has its own folder, home and network, so that `rect sim` can use its default port.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import threading
import time
from pathlib import Path

#: Time for a command that is expected to end, in seconds; some compile a program.
_COMMAND_TIMEOUT = 240
#: Time until a background command prints an expected line, in seconds.
_OUTPUT_TIMEOUT = 60


class Session:
    """The terminals of one page."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        self._folder = folder
        self._environment = environment
        self._background: list[_Command] = []
        self._last: _Command | None = None

    def run(self, commands: str) -> None:
        """Runs commands to their end. Fails if one of them fails."""
        self._last = _Command(commands, self._folder, self._environment)
        status = self._last.wait(_COMMAND_TIMEOUT)
        assert status == 0, f"status {status}:\n{commands}\n{self._last.output}"

    def start(self, commands: str) -> None:
        """Starts commands that run until `stop`."""
        self._last = _Command(commands, self._folder, self._environment)
        self._background.append(self._last)

    def expect(self, output: str) -> None:
        """Waits until the last commands have printed these lines in this order."""
        assert self._last is not None, "no commands before this output"
        patterns = [_pattern(line.strip()) for line in output.splitlines() if line.strip()]
        deadline = time.monotonic() + _OUTPUT_TIMEOUT
        while not _in_order(patterns, self._last.output):
            ended = not self._last.is_running
            if (ended or time.monotonic() > deadline) and not _in_order(patterns, self._last.output):
                raise AssertionError(f"expected:\n{output}\nprinted:\n{self._last.output}")
            time.sleep(0.05)

    def stop(self) -> None:
        """Ends the background commands, the last one first, and checks that none of them had failed before."""
        while self._background:
            self.stop_last()

    def stop_last(self) -> None:
        """Ends the background commands that were started last, and checks that they had not failed before."""
        self._background.pop().interrupt()


class _Command:
    """Commands of one terminal and what they have printed."""

    def __init__(self, commands: str, folder: Path, environment: dict[str, str]) -> None:
        self._commands = commands
        self._process = subprocess.Popen(
            # A process that was started in the background of a script ignores Ctrl-C.
            ["env", "--default-signal=INT", "bash", "-euo", "pipefail", "-c", commands],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self.output = ""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def is_running(self) -> bool:
        """Whether the commands run, or their output has not been read to its end."""
        return self._reader.is_alive()

    def wait(self, timeout: float) -> int:
        try:
            status = self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            self._kill()
            raise AssertionError(f"still running after {timeout} s:\n{self._commands}\n{self.output}") from None
        # Background processes of the commands may keep the output open.
        self._reader.join(1)
        return status

    def interrupt(self) -> None:
        assert self._process.poll() is None, f"ended too early:\n{self._commands}\n{self.output}"
        # A shell that is about to start its command loses the signal, so it is sent again.
        for _ in range(10):
            os.killpg(self._process.pid, signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(3)
                return
        self._kill()
        raise AssertionError(f"still running 30 s after Ctrl-C:\n{self._commands}\n{self.output}")

    def _kill(self) -> None:
        os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.output += line


def _pattern(line: str) -> re.Pattern[str]:
    return re.compile(".*?".join(re.escape(part) for part in line.split("...")))


def _in_order(patterns: list[re.Pattern[str]], output: str) -> bool:
    """Returns whether each pattern matches a line of the output, in this order."""
    lines = iter(output.splitlines())
    return all(any(pattern.search(line) for line in lines) for pattern in patterns)
