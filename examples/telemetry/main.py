"""Telemetry: a robot tells its arm's angle and its battery ten times a second, as small as can be, and hears others'.

python examples/telemetry/main.py wombat-1
"""

import json
import math
import sys
import time

import rect


def measured(n: int) -> dict[str, object]:
    return {"angle_deg": round(math.sin(n / 20) * 90, 1), "battery_volt": 7.2, "moving": n % 100 < 50}


def main(name: str = "wombat-1") -> None:
    with rect.connect(name) as robot:
        # Messages like those to come make a dictionary: 60 bytes become a third. Others fetch it by themselves.
        samples = [json.dumps(measured(n), separators=(",", ":")).encode() for n in range(2000)]
        packed = robot.share(rect.Dictionary.train(samples, 4096))

        robot.subscribe("*/telemetry", lambda message: print(f"{message.sender}: {message.value}", flush=True))
        for n in range(2**62):
            robot.publish("telemetry", measured(n), codec=packed)
            time.sleep(0.1)


if __name__ == "__main__":
    main(*sys.argv[1:])
