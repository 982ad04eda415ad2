"""Teleoperation: urgent drive commands overtake all other messages, and expire. A robot that receives none stops.

python examples/teleoperation/main.py wombat-1             # receives commands
python examples/teleoperation/main.py laptop wombat-1      # sends commands
"""

import contextlib
import math
import sys
import time

import rect


def main(me: str = "wombat-1", other: str = "") -> None:
    with rect.connect(me) as robot:
        drive(robot, other) if other else follow(robot)


def drive(robot: rect.Robot, other: str) -> None:
    for left in (math.sin(n / 20) for n in range(200)):
        with contextlib.suppress(rect.NotReachable):  # it stops by itself, and is steered again when it is back
            robot.send(other, "drive", rect.Cbor({"left": left, "right": -left}), urgency="urgent", expires_after=0.2)
        time.sleep(0.05)
    robot.send(other, "drive", rect.Cbor({"left": 0.0, "right": 0.0}), urgency="urgent")


def follow(robot: rect.Robot) -> None:
    commands = robot.subscribe("*/drive")
    while True:
        try:
            message = commands.next(timeout=0.5)
            print(f"{message.sender}: {message.value}", flush=True)
        except rect.TimedOut:
            print("no commands, stopping", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
