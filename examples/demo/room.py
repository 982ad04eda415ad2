"""Runs a simulated room: the air, a router for each robot, and interruptions of the radio."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from robots import Robot, RobotError, start, wait_until


class Room:
    """A simulated air with robots. Leaving the context ends all processes."""

    def __init__(self, condition: str, *air_options: str, has_wifi: bool = False) -> None:
        self._air_options = ["--condition", condition, *air_options]
        self._has_wifi = has_wifi
        self._wifi: subprocess.Popen | None = None
        self._robots: list[Robot] = []

    def __enter__(self) -> Room:
        self._folder = Path(tempfile.mkdtemp(prefix="rect-demo-"))
        self._environment = {"RECT_AIR": str(self._folder / "air.sock")}
        command = [os.environ.get("RECT_TOOL", "rect"), "air", "serve", *self._air_options]
        self._air = start(command, self._folder / "air.log", os.environ | self._environment)
        wait_until("the simulated air is up", 10, lambda: self._command("status").returncode == 0)
        if self._has_wifi:
            command = [os.environ.get("RECT_ROUTER", "rect-router"), "wifi", "serve"]
            self._wifi = start(command, self._folder / "wifi.log", os.environ | self._environment)
            wait_until("the simulated Wi-Fi is up", 10, (self._folder / "air.sock.wifi").exists)
        return self

    def __exit__(self, *failure: object) -> None:
        for robot in self._robots:
            robot.stop()
        for server in filter(None, [self._wifi, self._air]):
            server.terminate()
            server.wait(10)
        if failure[0] is None:
            shutil.rmtree(self._folder)
        else:
            print(f"The routers' logs are in {self._folder}")

    def add_robot(
        self,
        name: str,
        dial_options: str = "",
        arguments: tuple[str, ...] = (),
        kind: type[Robot] = Robot,
        ble_options: str = "",
        dials: list[Robot] | None = None,
    ) -> Robot:
        """Starts a robot's router, which dials `dials` (default: all earlier robots) with `dial_options` in the
        locator. `ble_options` are those of its listener."""
        robot = kind(name, f"sim-{name}", self._folder / f"{name}.log", self._environment, arguments)
        others = self._robots if dials is None else dials
        robot.start([f"{kind.method}/{other.name}{dial_options}" for other in others], ble_options)
        self._robots.append(robot)
        return robot

    def environment(self) -> dict[str, str]:
        return os.environ | self._environment

    def cut(self) -> None:
        """Moves all robots out of range of each other, until `restore` is called."""
        self._control("cut")

    def restore(self) -> None:
        self._control("restore")

    def set_condition(self, condition: str) -> None:
        """Changes the radio condition, such as `edge-of-range`."""
        self._control("condition", condition)

    def set_wifi(self, state: str) -> None:
        """Sets the state of the simulated Wi-Fi: `on`, `silent` or `off`."""
        command = [os.environ.get("RECT_ROUTER", "rect-router"), "wifi", state]
        subprocess.run(command, env=self.environment(), check=True, timeout=10)

    def status(self) -> dict:
        """Returns the adapters of the air and their counters."""
        return json.loads(self._command("status", "--json").stdout)

    def _control(self, *arguments: str) -> None:
        done = self._command(*arguments)
        if done.returncode != 0:
            raise RobotError(done.stderr.strip())

    def _command(self, *arguments: str) -> subprocess.CompletedProcess:
        command = [os.environ.get("RECT_TOOL", "rect"), "air", *arguments]
        return subprocess.run(command, env=self.environment(), capture_output=True, text=True, timeout=10)


def wait_for_link(one: Robot, two: Robot, limit_s: float = 20) -> float:
    """Waits until both routers report a link, and returns the seconds that took."""
    return wait_until(
        f"{one.name} and {two.name} are linked", limit_s, lambda: bool(one.ble_links() and two.ble_links())
    )


def wait_for_no_link(one: Robot, two: Robot, limit_s: float = 20) -> float:
    """Waits until neither router reports a link, and returns the seconds that took."""
    return wait_until(
        f"{one.name} and {two.name} are no longer linked", limit_s, lambda: not one.ble_links() and not two.ble_links()
    )
