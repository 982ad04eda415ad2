"""Runs the bare programs that the routers are compared with."""

import json
import os
import subprocess

from robots import RobotError


def figures_of(command: list[str], environment: dict[str, str] | None = None) -> dict:
    """Runs a program, and returns the figures that it prints as JSON."""
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    if done.returncode != 0:
        raise RobotError(f"{' '.join(command)}: {done.stderr}")
    return json.loads(done.stdout)


def bare_channel(mode: str, near: str, far: str, *arguments: str, environment: dict[str, str] | None = None) -> dict:
    """Runs `ping` or `flood` over a bare channel from one adapter to another."""
    program = os.environ["RECT_CHANNEL"]
    server = subprocess.Popen([program, "serve", far], env=environment, stdout=subprocess.PIPE, text=True)
    try:
        address = json.loads(server.stdout.readline())["address"]
        return figures_of([program, mode, near, address, *arguments], environment)
    finally:
        server.terminate()
        server.wait()
