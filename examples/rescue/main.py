"""Rescue: each robot publishes its battery and serves its pose. If the battery of one is low, the others ask it.

python examples/rescue/main.py wombat-1
python examples/rescue/main.py wombat-2 12      # its battery has 12 percent
"""

import sys
from contextlib import suppress
from dataclasses import dataclass

import rect


@dataclass
class Battery:
    percent: float
    charging: bool = False


@dataclass
class Pose:
    x: float
    y: float


def pose(request: rect.Request) -> Pose:
    return Pose(1.5, 0.5)


def main(name: str = "wombat-1", percent: str = "80") -> None:
    with rect.connect(name) as robot:
        robot.serve("pose", pose)
        publisher = robot.publisher("battery", Battery)
        batteries = robot.subscribe("*/battery", Battery)
        publisher.wait_for_subscriber(timeout=60)
        publisher.publish(Battery(float(percent)))
        for message in batteries:
            if message.problem:
                print(f"{message.sender}: {message.problem}", flush=True)
            elif message.value.percent < 20 and not message.value.charging:
                place = robot.request(message.sender, "pose", returns=Pose).value
                print(f"{message.sender} needs help at {place.x}, {place.y}", flush=True)
            else:
                print(f"{message.sender}: {message.value.percent} percent", flush=True)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main(*sys.argv[1:])
