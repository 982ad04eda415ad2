"""Provides the routers of two robots that are linked on the simulated air, and runs the `rect` command at them."""

from __future__ import annotations

import functools
import os
import queue
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import rect

sys.path.append(str(Path(__file__).resolve().parents[2] / "examples" / "demo"))

#: Timeout after which a test fails, in seconds.
DEADLINE = 30.0


def until(condition: Callable[[], bool], found: Callable[[], object] = lambda: None) -> None:
    """Waits until a condition holds. `found` is what a failure shows."""
    deadline = time.monotonic() + DEADLINE
    while not condition():
        assert time.monotonic() < deadline, found()
        time.sleep(0.01)


def program(variable: str, name: str) -> str:
    """Returns the path of a program. Fails the test if the program is not built."""
    found = os.environ.get(variable) or shutil.which(name)
    assert found, f"{name} was not found: build it with `scripts/build-for-tests`, and set {variable} to its path"
    return found


class Routers:
    """The routers of `wombat-1` and `wombat-2`, which are linked by simulated Bluetooth."""

    def __init__(self, room: Any, one: Any, two: Any) -> None:
        self.room = room
        self.robots = {"wombat-1": one, "wombat-2": two}
        self.endpoints = {"wombat-1": one.endpoint(), "wombat-2": two.endpoint()}

    def connect(self, name: str, program: str | None = "") -> rect.Robot:
        return rect.connect(name, router=self.endpoints[name], program=program)

    @contextmanager
    def without_link(self) -> Iterator[None]:
        """Moves the robots out of range of each other, and yields when both have noticed that."""
        from room import (  # type: ignore[import-not-found, unused-ignore]
            wait_for_link,
            wait_for_no_link,
        )

        one, two = self.robots.values()
        self.room.cut()
        try:
            wait_for_no_link(one, two)
            yield
        finally:
            self.room.restore()
            wait_for_link(one, two)

    def restart(self, name: str) -> None:
        """Kills the router of a robot, starts it again, and waits for the link."""
        from room import wait_for_link  # type: ignore[import-not-found, unused-ignore]

        self.robots[name].kill()
        self.robots[name].start()
        wait_for_link(*self.robots.values())

    @contextmanager
    def tool(self, robot: str, *arguments: str) -> Iterator[Tool]:
        """Runs the `rect` command at the router of a robot."""
        options = ["--as", robot, "--router", self.endpoints[robot]]
        # The arguments after `--` belong to another program.
        end = arguments.index("--") if "--" in arguments else len(arguments)
        command = [program("RECT_TOOL", "rect"), *arguments[:end], *options, *arguments[end:]]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            tool = Tool(process)
            try:
                yield tool
            finally:
                process.terminate()
                tool.finish_reading()


class Tool:
    """A running command whose output is read line by line."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        streams = (process.stdout, process.stderr)
        self._readers = [threading.Thread(target=self._read, args=(stream,)) for stream in streams]
        for reader in self._readers:
            reader.start()

    def line(self) -> str:
        return self._lines.get(timeout=DEADLINE)

    def until(self, expected: str) -> str:
        """Returns the first line that contains `expected`. Skips other lines, such as those of Zenoh's log."""
        line = self.line()
        while expected not in line:
            line = self.line()
        return line

    def ends(self) -> int:
        return self.process.wait(DEADLINE)

    def finish_reading(self) -> None:
        """Waits until the output of the ended command is read."""
        for reader in self._readers:
            reader.join()

    def _read(self, stream: Any) -> None:
        for line in stream:
            self._lines.put(line.rstrip("\n"))


@contextmanager
def linked_routers(folder: Path, *air_options: str) -> Iterator[Routers]:
    """Starts the routers, whose connections files are in `folder`, and yields them. `air_options` are those of
    `rect air serve`."""
    files = {name: folder / f"{name}.json" for name in ("wombat-1", "wombat-2")}
    for file in files.values():
        file.write_text('{"connections": []}')
    os.environ["RECT_ROUTER"] = program("RECT_ROUTER", "rect-router")
    os.environ["RECT_TOOL"] = program("RECT_TOOL", "rect")
    from robots import rect_settings  # type: ignore[import-not-found, unused-ignore]
    from room import Room, wait_for_link  # type: ignore[import-not-found, unused-ignore]

    with Room("desk", *air_options) as room:
        one, two = (
            room.add_robot(name, arguments=tuple(rect_settings({"robot": name, "connections": str(file)})))
            for name, file in files.items()
        )
        wait_for_link(one, two)
        yield Routers(room, one, two)


@contextmanager
def initialised_routers(
    folder: Path, edit: Callable[[str], str] = lambda configuration: configuration
) -> Iterator[dict[str, dict[str, Any]]]:
    """Starts the routers of two robots as `rect init` configures them, with an edited configuration. Yields the options
    for programs."""
    from robots import free_port, is_listening  # type: ignore[import-not-found, unused-ignore]
    from room import Room  # type: ignore[import-not-found, unused-ignore]

    router = program("RECT_ROUTER", "rect-router")
    users = folder / "wombat-1" / "users"
    with Room("desk") as room, ExitStack() as stack:
        options: dict[str, dict[str, Any]] = {}
        for name in ("wombat-1", "wombat-2"):
            port = free_port()
            init = ["init", name, "--adapter", f"sim-{name}", "--folder", str(folder / name), "--port", str(port)]
            team = [] if name == "wombat-1" else ["--users", str(users)]
            subprocess.run([router, *init, *team], check=True, capture_output=True)
            dials = [] if name == "wombat-1" else ["-e", "any/wombat-1"]
            configuration = folder / name / "robot.json5"
            configuration.write_text(edit(configuration.read_text()))
            command = [router, "-c", str(configuration), *dials]
            log = stack.enter_context((folder / f"{name}.log").open("w"))
            process = subprocess.Popen(command, env=room.environment(), stdout=log, stderr=log)
            stack.callback(process.wait)
            stack.callback(process.kill)
            until(functools.partial(is_listening, port))
            options[name] = {"router": f"tcp/127.0.0.1:{port}", "login_file": str(users)}
        yield options
