"""Runs the two routers that are compared, each with only a local TCP listener."""

import os
import subprocess
from pathlib import Path

from robots import free_port, is_listening, open_client, wait_until

PROGRAMS = {"rect-router": "RECT_ROUTER", "stock zenohd": "STOCK_ZENOHD"}


class Router:
    """One of `PROGRAMS`, running. Its warnings go to `log`."""

    def __init__(self, program: str, *arguments: str, log: Path = Path(os.devnull)) -> None:
        self.path = Path(os.environ[PROGRAMS[program]])
        self._port = free_port()
        self.endpoint = f"tcp/127.0.0.1:{self._port}"
        command = [self.path, "-l", self.endpoint, "--no-multicast-scouting", *arguments]
        with log.open("a") as out:
            environment = os.environ | {"RUST_LOG": "warn"}
            self._process = subprocess.Popen(command, env=environment, stdout=out, stderr=subprocess.STDOUT)
        self.pid = self._process.pid

    def __enter__(self) -> "Router":
        wait_until(f"{self.path.name} is up", 20, lambda: is_listening(self._port))
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait(10)

    def kill(self) -> None:
        """Ends it at once, like a power cut."""
        self._process.kill()

    def status(self, field: str) -> int:
        return status(self.pid, field)

    def own_kb(self) -> int:
        return own_kb(self.pid)

    def wait_for_answer(self, selector: str) -> None:
        """Waits until a client of this router gets an answer to `selector`."""
        with open_client(self.endpoint) as session:
            wait_until(f"{selector} is answered", 20, lambda: any(r.ok for r in session.get(selector, timeout=1)))


def status(pid: int, field: str) -> int:
    """Returns a number of /proc/<pid>/status: VmRSS (kB), VmHWM (kB, the peak so far), Threads."""
    text = Path(f"/proc/{pid}/status").read_text()
    return next(int(line.split()[1]) for line in text.splitlines() if line.startswith(f"{field}:"))


def own_kb(pid: int) -> int:
    """Returns the private memory of a process in kB: heap, stacks, changed data. The rest of the resident memory is
    program text, which the system may drop and read from the file again."""
    text = Path(f"/proc/{pid}/smaps_rollup").read_text()
    return sum(int(line.split()[1]) for line in text.splitlines() if line.startswith(("Anonymous:", "Swap:")))
