"""Telemetry: a robot publishes its arm's angle and battery voltage ten times per second, compressed with a dictionary,
and prints those of other robots.

python examples/telemetry/main.py wombat-1
"""

import json
import math
import sys
import time

import rect


def measure(n: int) -> dict[str, object]:
    return {"angle_deg": round(math.sin(n / 20) * 90, 1), "battery_volt": 7.2, "moving": n % 100 < 50}


def main(name: str = "wombat-1") -> None:
    with rect.connect(name) as robot:
        # Trains a dictionary on messages of the same kind. With it, a message of 60 bytes shrinks to a third. Receivers
        # fetch the dictionary automatically.
        samples = [json.dumps(measure(n), separators=(",", ":")).encode() for n in range(2000)]
        codec = robot.share_dictionary(rect.Dictionary.train(samples, 4096))

        robot.subscribe("*/telemetry", lambda message: print(f"{message.sender}: {message.value}", flush=True))
        for n in range(2**62):
            robot.publish("telemetry", measure(n), codec=codec)
            time.sleep(0.1)


if __name__ == "__main__":
    main(*sys.argv[1:])
