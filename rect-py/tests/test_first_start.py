"""Tests `python -m rect init` and the command that it prints: `scripts/test-python -k first_start`"""

from __future__ import annotations

import os
import shlex
import socket
import subprocess
import sys
import time
from pathlib import Path


def test_init_prints_command_that_starts_router(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = str(listener.getsockname()[1])
    init = ["init", "wombat-1", "--adapter", "sim-module", "--folder", "a robot", "--port", port]
    output = subprocess.run(
        [sys.executable, "-m", "rect", *init], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout
    (command,) = (
        line.removeprefix("start it with: ") for line in output.splitlines() if line.startswith("start it with: ")
    )
    with (tmp_path / "log").open("w") as log:
        # An air of its own: the default one may have robots that the user has started.
        environment = {**os.environ, "RECT_AIR": str(tmp_path / "air.sock")}
        router = subprocess.Popen(shlex.split(command), cwd="/", env=environment, stdout=log, stderr=log)
    try:
        deadline = time.monotonic() + 30
        while "rect-router is up" not in (text := (tmp_path / "log").read_text()):
            assert router.poll() is None and time.monotonic() < deadline, text
            time.sleep(0.02)
    finally:
        router.kill()
        router.wait()


def test_module_runs_commands_of_the_tool(tmp_path: Path) -> None:
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, "-m", "rect", *arguments], capture_output=True, text=True, cwd=tmp_path)

    for command in ("peers", "sub", "request", "air", "sim", "doctor"):
        shown = run(command, "--help")
        assert shown.returncode == 0 and f"rect {command}" in shown.stdout, shown
    # `router` runs the router, and what follows are its arguments.
    assert "rect-router" in run("router", "--version").stdout
    assert run().returncode == 2 and "peers" in run().stdout
