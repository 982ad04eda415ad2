"""Teleoperation: steering commands overtake everything else, and a robot that hears none for half a second stops.

python examples/teleoperation/main.py wombat-1             # is driven
python examples/teleoperation/main.py laptop wombat-1      # drives it
"""

import math
import sys
import time

import rect

STOP = {"left": 0.0, "right": 0.0}


def main(me: str = "wombat-1", other: str = "") -> None:
    with rect.connect(me) as robot:
        (drive if other else be_driven)(robot, other)


def drive(robot: rect.Robot, other: str) -> None:
    for left in (math.sin(n / 20) for n in range(200)):
        robot.send(other, "drive", rect.Cbor({"left": left, "right": -left}), urgency="urgent")
        time.sleep(0.05)
    robot.send(other, "drive", rect.Cbor(STOP), urgency="urgent")


def be_driven(robot: rect.Robot, _: str) -> None:
    commands = robot.subscribe("*/drive")
    while True:
        try:
            message = commands.next(timeout=0.5)
            print(f"{message.sender} says {message.value}", flush=True)
        except rect.TimedOut:
            print(f"nobody steers: {STOP}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
