"""A simulated room with robots in it: the air, a router for each robot, and what the demo asks of them."""

import json
import os
import shutil
import socket
import subprocess
import tempfile
import time
from pathlib import Path

import zenoh

CONFIG = Path(__file__).resolve().parents[2] / "config" / "simulation.json5"


class RoomError(Exception):
    """Something that had to happen did not."""


class Robot:
    def __init__(self, name: str, port: int, process: subprocess.Popen, log: Path) -> None:
        self.name = name
        self.port = port
        self.process = process
        self.log = log

    def client_config(self) -> zenoh.Config:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", json.dumps([f"tcp/127.0.0.1:{self.port}"]))
        config.insert_json5("scouting/multicast/enabled", "false")
        return config


class Room:
    """Starts the simulated air; ends everything it started."""

    def __init__(self, condition: str) -> None:
        self._condition = condition
        self._robots: list[Robot] = []

    def __enter__(self) -> "Room":
        self._folder = Path(tempfile.mkdtemp(prefix="rect-demo-"))
        self._environment = os.environ | {"RECT_AIR": str(self._folder / "air.sock"), "RUST_LOG": "info"}
        self._air = self._start(
            ["rect", "air", "serve", "--condition", self._condition, "--pdu", "27"], self._folder / "air.log"
        )
        self._wait("the simulated air", 10, lambda: self._command("air", "status").returncode == 0)
        return self

    def __exit__(self, *failure: object) -> None:
        for process in [robot.process for robot in self._robots] + [self._air]:
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
        if failure[0] is None:
            shutil.rmtree(self._folder)
        else:
            print(f"The routers' logs are in {self._folder}")

    def add_robot(self, name: str) -> Robot:
        """A robot's router; it dials every robot that is there already."""
        port = free_port()
        command = ["rect-router", "-c", str(CONFIG)]
        command += ["-l", f"ble/sim-{name}#name={name}", "-l", f"tcp/127.0.0.1:{port}"]
        for other in self._robots:
            command += ["-e", f"ble/{other.name}#adapter=sim-{name}"]
        log = self._folder / f"{name}.log"
        robot = Robot(name, port, self._start(command, log), log)
        self._wait(f"the router of {name}", 10, lambda: accepts(port), robot)
        self._robots.append(robot)
        return robot

    def wait_for_link(self, one: Robot, two: Robot, limit_s: float) -> float:
        return self._wait(f"a link of {one.name} and {two.name}", limit_s, lambda: is_linked(one) and is_linked(two))

    def wait_for_no_link(self, one: Robot, two: Robot, limit_s: float) -> float:
        return self._wait("the end of the link", limit_s, lambda: not is_linked(one) and not is_linked(two))

    def cut(self) -> None:
        self._control("cut")

    def restore(self) -> None:
        self._control("restore")

    def usage(self) -> str:
        status = json.loads(self._command("air", "status", "--json").stdout)
        adapters = status["adapters"]
        return ", ".join(
            f"{a['name'].removeprefix('sim-')} sent {a['stats']['bytes_on_air'] / 1000:.0f} kB" for a in adapters
        )

    def _control(self, *arguments: str) -> None:
        done = self._command("air", *arguments)
        if done.returncode != 0:
            raise RoomError(done.stderr.strip())

    def _command(self, *arguments: str) -> subprocess.CompletedProcess:
        return subprocess.run(["rect", *arguments], env=self._environment, capture_output=True, text=True, timeout=10)

    def _start(self, command: list[str], log: Path) -> subprocess.Popen:
        if shutil.which(command[0]) is None:
            raise RoomError(f"{command[0]} is not in the PATH: run `make demo`, which builds it")
        with log.open("w") as out:
            return subprocess.Popen(command, env=self._environment, stdout=out, stderr=subprocess.STDOUT)

    def _wait(self, what: str, limit_s: float, there, robot: Robot | None = None) -> float:
        started = time.monotonic()
        while not there():
            if robot and robot.process.poll() is not None:
                raise RoomError(f"{what} ended: {robot.log.read_text().strip().splitlines()[-1]}")
            if time.monotonic() - started > limit_s:
                raise RoomError(f"{what} did not come within {limit_s} s")
            time.sleep(0.05)
        return time.monotonic() - started


def is_linked(robot: Robot) -> bool:
    """Whether the router's admin space shows a `ble/` link."""
    with zenoh.open(robot.client_config()) as session:
        for reply in session.get("@/*/router", timeout=2):
            if reply.ok is None:
                continue
            state = json.loads(reply.ok.payload.to_bytes())
            if state["locators"] and str(robot.port) not in json.dumps(state["locators"]):
                continue
            links = [link for s in state["sessions"] for link in s["links"]]
            return any(link["src"].startswith("ble/") for link in links)
    return False


def accepts(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
