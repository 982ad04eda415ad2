"""Teleoperation: urgent drive commands overtake all other messages, and expire. A robot that receives none stops.

python examples/teleoperation/main.py wombat-1             # receives commands
python examples/teleoperation/main.py laptop wombat-1      # sends commands
"""

import functools
import math
import sys
import threading
import time
from contextlib import suppress

import rect


def main(me: str = "wombat-1", other: str = "") -> None:
    with suppress(KeyboardInterrupt), rect.connect(me) as robot:
        drive(robot, other) if other else follow(robot)


def drive(robot: rect.Robot, other: str) -> None:
    for left in (math.sin(n / 20) for n in range(200)):
        with suppress(rect.NotReachable):  # it stops by itself, and is steered again when it is back
            robot.send(other, "drive", rect.Cbor({"left": left, "right": -left}), urgency="urgent", expires_after=0.2)
        time.sleep(0.05)
    robot.send(other, "drive", rect.Cbor({"left": 0.0, "right": 0.0}), urgency="urgent")


def follow(robot: rect.Robot) -> None:
    def execute(message: rect.Message) -> None:
        print(f"{message.sender}: {message.value}", flush=True)

    robot.deadman("*/drive", execute, within=0.5, on_lost=functools.partial(print, "stopping:", flush=True))
    threading.Event().wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
