"""Runs a program with two routers on the simulated air. Their endpoints are in the environment variables RECT_ROUTER_1
(robot `wombat-1`) and RECT_ROUTER_2 (robot `wombat-2`).

RECT_ROUTER=... RECT_TOOL=... .venv/bin/python rect-cpp/tests/run_with_routers.py PROGRAM [ARGUMENT ...]
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "examples" / "demo"))

from robots import rect_settings
from room import Room, wait_for_link


def main(*command: str) -> int:
    with tempfile.TemporaryDirectory() as folder, Room("desk") as room:
        robots = []
        for name in ("wombat-1", "wombat-2"):
            connections = Path(folder) / f"{name}.json"
            connections.write_text('{"connections": []}')
            settings = rect_settings({"robot": name, "connections": str(connections)})
            robots.append(room.add_robot(name, arguments=tuple(settings)))
        wait_for_link(*robots)
        endpoints = {f"RECT_ROUTER_{n}": robot.endpoint() for n, robot in enumerate(robots, 1)}
        return subprocess.run(command, env=os.environ | endpoints, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
