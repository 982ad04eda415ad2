"""Runs robots as processes, each a router with stock eclipse-zenoh clients, for the demo, test scenarios and
benches."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import zenoh

CONFIG = Path(__file__).resolve().parents[2] / "config" / "simulation.json5"


class RobotError(Exception):
    """An expected event did not happen."""


class Robot:
    """A router with a `ble/` listener under the robot's name and a local TCP port for programs."""

    #: The method of its links to other robots.
    method = "ble"

    def __init__(
        self,
        name: str,
        adapter: str,
        log: Path,
        environment: dict[str, str] | None = None,
        arguments: tuple[str, ...] = (),
    ) -> None:
        """Creates a robot whose router is not running yet. `arguments` are additional arguments of the router."""
        self.name = name
        self.port = free_port()
        self._adapter = adapter
        self._log = log
        self._arguments = arguments
        self._environment = (
            os.environ
            | {
                "RUST_LOG": "warn,rect_router=info,zenoh_link_ble=debug,zenoh_link_any=debug,"
                "zenoh::net::runtime::orchestrator=debug"
            }
            | (environment or {})
        )
        self._process: subprocess.Popen | None = None
        self._dials: list[str] = []
        self._listens: list[str] = []
        self._ble_options = ""

    def start(
        self,
        dials: list[str] | None = None,
        ble_options: str | None = None,
        wait: bool = True,
        listens: list[str] | None = None,
    ) -> Robot:
        """Starts the router, which dials `dials` and additionally listens on `listens`. `ble_options` are appended to
        the locator of its `ble/` listener.

        An argument that is None keeps the value of the previous start."""
        if dials is not None:
            self._dials = dials
        if listens is not None:
            self._listens = listens
        if ble_options is not None:
            self._ble_options = ble_options
        command = self._command(f"{self.method}/{self._adapter}#name={self.name}{self._ble_options}")
        self._process = start(command, self._log, self._environment)
        if wait:
            self.wait_until_up()
        return self

    def _command(self, ble_listener: str) -> list[str]:
        command = [os.environ.get("RECT_ROUTER", "rect-router"), "-c", str(CONFIG)]
        command += ["-l", ble_listener, "-l", f"tcp/127.0.0.1:{self.port}", *self._arguments]
        for locator in self._listens:
            command += ["-l", locator]
        for locator in self._dials:
            command += ["-e", locator]
        return command

    def wait_until_up(self) -> None:
        wait_until(f"the router of {self.name} is up", 30, self._accepts)

    def kill(self) -> None:
        """Ends the router at once, like a power cut."""
        if self._process:
            self._process.kill()
            self._process.wait()
            self._process = None

    def freeze(self) -> None:
        """Stops the router's process without closing its links, so that its peers are not notified."""
        if self._process:
            self._process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Continues the process after `freeze`."""
        if self._process:
            self._process.send_signal(signal.SIGCONT)

    def stop(self) -> None:
        """Requests the router to end, and kills it if it has not ended after 10 s."""
        if self._process:
            self._process.terminate()
            try:
                self._process.wait(10)
            except subprocess.TimeoutExpired:
                self.kill()
            self._process = None

    def pid(self) -> int:
        if self._process is None:
            raise RobotError(f"the router of {self.name} is not running")
        return self._process.pid

    def ended(self) -> bool:
        return self._process is None or self._process.poll() is not None

    def session(self) -> zenoh.Session:
        """Opens a stock client of this robot's router."""
        return open_client(self.endpoint())

    def endpoint(self) -> str:
        """Returns the locator at which programs reach the router."""
        return f"tcp/127.0.0.1:{self.port}"

    def ble_links(self) -> list[str]:
        """Returns the names of the peers of its `ble/` links, from its admin space (`ble/wombat-2?rel=1`)."""
        with self.session() as session:
            own = str(session.info.routers_zid()[0])
            for reply in session.get(f"@/{own}/router", timeout=5):
                if reply.ok is not None:
                    state = json.loads(reply.ok.payload.to_bytes())
                    links = [link for s in state["sessions"] for link in s["links"]]
                    peers = [link["dst"] for link in links if link["src"].startswith("ble/")]
                    return [peer.removeprefix("ble/").split("?")[0] for peer in peers]
        return []

    def log(self) -> str:
        return self._log.read_text()

    def _accepts(self) -> bool:
        if self.ended():
            raise RobotError(f"the router of {self.name} ended: {self.log().strip().splitlines()[-1]}")
        return is_listening(self.port)


class AnyRobot(Robot):
    """A robot with a link over Bluetooth and Wi-Fi at once to each other one. Its team has a secret."""

    method = "any"

    def _command(self, ble_listener: str) -> list[str]:
        secret = self._log.with_name("secret")
        secret.write_text("team:the secret of the team\n")
        return [*super()._command(f"{ble_listener};secret={secret}"), *rect_settings({"robot": self.name})]

    def paths(self) -> list[dict]:
        """Returns the live paths of its link, as its registry reports them."""
        with self.session() as session:
            for reply in session.get(f"rect/{self.name}/@rect/connections?method=any;state=connected", timeout=5):
                if reply.ok is not None:
                    links = json.loads(reply.ok.payload.to_bytes())
                    paths = [path for link in links for path in link["paths"]]
                    return [path for path in paths if path["state"] == "live"]
        return []

    def has_path(self, method: str) -> bool:
        return any(path["method"] == method for path in self.paths())

    def bulk_path(self) -> str:
        """Returns the method of the path that carries the bulk, or an empty text."""
        return next((path["method"] for path in self.paths() if path["is_primary"]), "")


class PluginRobot(Robot):
    """A robot whose router is a stock zenohd with our plugin. It dials the named connections of a file."""

    def _command(self, ble_listener: str) -> list[str]:
        connections = self._log.with_suffix(".connections.json")
        named = [{"name": to[4:], "method": "ble", "address": to[4:]} for to in self._dials]
        connections.write_text(json.dumps({"connections": named}))
        command = [os.environ["RECT_ZENOHD"], "-P", f"rect:{os.environ['RECT_PLUGIN']}", "--no-multicast-scouting"]
        command += ["-l", f"tcp/127.0.0.1:{self.port}", *self._arguments]
        settings = {"robot": self.name, "listen": [ble_listener], "connections": str(connections)}
        return command + rect_settings(settings)

    def ble_links(self) -> list[str]:
        """Returns the names of the peers from its registry, because the host's admin space lacks the plugin's links."""
        with self.session() as session:
            for reply in session.get(f"rect/{self.name}/@rect/connections?method=ble;state=connected", timeout=5):
                if reply.ok is not None:
                    links = json.loads(reply.ok.payload.to_bytes())
                    return [link["peer"]["robot"] or link["address"] for link in links]
        return []


def rect_settings(settings: dict[str, object]) -> list[str]:
    """Returns RECT's settings as a router's flags. Each has a flag of its own, because `-P` adds another setting
    there."""
    return [part for key, value in settings.items() for part in ("--cfg", f"plugins/rect/{key}:{json.dumps(value)}")]


class Collector:
    """Collects the messages that arrive on a key. The constructor returns when the first message has arrived."""

    def __init__(self, receiver: zenoh.Session, key: str, sender: zenoh.Session, limit_s: float = 30) -> None:
        self._key = key
        self._limit_s = limit_s
        self._arrived = threading.Condition()
        self._payloads: list[bytes] = []
        self._reached = threading.Event()
        self._subscriber = receiver.declare_subscriber(key, self._on_sample)
        self.wait_until_reached(sender)

    def wait_until_reached(self, sender: zenoh.Session) -> float:
        """Publishes small probes until one arrives, because the subscription takes time to reach the sender. Returns
        the seconds that took."""
        self._reached.clear()
        started = time.monotonic()
        while not self._reached.wait(0.05):
            if time.monotonic() - started > self._limit_s:
                raise RobotError(f"no message reached the subscriber to {self._key} within {self._limit_s} s")
            sender.put(self._key, b"?")
        return time.monotonic() - started

    def take(self, count: int) -> list[bytes]:
        """Waits until `count` messages have arrived, and returns and removes them. Fails if there are fewer or more."""
        with self._arrived:
            self._arrived.wait_for(lambda: len(self._payloads) >= count, self._limit_s)
            if len(self._payloads) != count:
                raise RobotError(f"{len(self._payloads)} of {count} messages on {self._key} arrived")
            taken, self._payloads = self._payloads, []
        return taken

    def close(self) -> None:
        self._subscriber.undeclare()

    def _on_sample(self, sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        if payload == b"?":
            self._reached.set()
            return
        with self._arrived:
            self._payloads.append(payload)
            self._arrived.notify_all()


def open_client(locator: str, **settings: object) -> zenoh.Session:
    """Opens a stock client of the router at `locator`. `settings` are Zenoh's, with `__` between the parts of a
    name."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([locator]))
    config.insert_json5("scouting/multicast/enabled", "false")
    for key, value in settings.items():
        config.insert_json5(key.replace("__", "/"), json.dumps(value))
    return zenoh.open(config)


def start(command: list[str], log: Path, environment: dict[str, str]) -> subprocess.Popen:
    if shutil.which(command[0]) is None:
        raise RobotError(f"{command[0]} is not in the PATH: run `make demo`, which builds it")
    with log.open("a") as out:
        return subprocess.Popen(command, env=environment, stdout=out, stderr=subprocess.STDOUT)


def wait_until(what: str, limit_s: float, holds: Callable[[], bool]) -> float:
    """Waits until `holds` returns true, and returns the seconds that took. `what` describes the condition."""
    started = time.monotonic()
    while not holds():
        if time.monotonic() - started > limit_s:
            raise RobotError(f"this condition was not met within {limit_s} s: {what}")
        time.sleep(0.05)
    return time.monotonic() - started


def is_listening(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
