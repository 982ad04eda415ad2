"""Telemetry: publishes an arm's angle and the battery's voltage ten times per second, and prints those of all robots.

python examples/telemetry/main.py wombat-1
python examples/telemetry/main.py wombat-1 compressed      # the messages after the first 100 have half the size
"""

import json
import math
import sys
import time
from contextlib import suppress

import rect


def measure(n: int) -> dict[str, object]:
    return {"angle_deg": round(math.sin(n / 20) * 90, 1), "battery_volt": 7.2, "moving": n % 100 < 50}


def publish(robot: rect.Robot, numbers: range, codec: "rect.Codec | None" = None) -> None:
    for n in numbers:
        robot.publish("telemetry", measure(n), codec=codec)
        time.sleep(0.1)


def publish_compressed(robot: rect.Robot) -> None:
    """Optional second step: trains a dictionary on the first 100 messages. Receivers fetch it automatically."""
    publish(robot, range(100))
    samples = [json.dumps(measure(n), separators=(",", ":")).encode() for n in range(100)]
    publish(robot, range(100, 2**62), robot.share_dictionary(rect.Dictionary.train(samples, 1024)))


def main(name: str = "wombat-1", step: str = "") -> None:
    with suppress(KeyboardInterrupt), rect.connect(name) as robot:
        robot.subscribe("*/telemetry", callback=lambda message: print(f"{message.sender}: {message.value}", flush=True))
        publish_compressed(robot) if step == "compressed" else publish(robot, range(2**62))


if __name__ == "__main__":
    main(*sys.argv[1:])
