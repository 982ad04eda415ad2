"""Provides telemetry as JSON lines: three generated kinds that resemble a robot's, and one from a weather station."""

import csv
import importlib.util
import json
import math
import random
from collections.abc import Callable
from pathlib import Path

START_MS = 1_795_000_000_000
DAY_MS = 86_400_000
Row = dict[str, object]


class Drift:
    """A value that drifts at random around its middle."""

    def __init__(self, noise: random.Random, middle: float, range_: float, digits: int) -> None:
        self.noise, self.middle, self.range, self.digits = noise, middle, range_, digits
        self.value = middle + noise.uniform(-range_, range_) / 2
        self.speed = 0.0

    def __call__(self) -> float:
        self.speed = 0.9 * self.speed + self.noise.gauss(0, self.range / 60)
        self.value += self.speed - (self.value - self.middle) / 200
        return round(self.value, self.digits)


def joint(robot: str, noise: random.Random, start_ms: int) -> Callable[[int], Row]:
    angles = {name: Drift(noise, 20, 60, 1) for name in ("base", "shoulder", "elbow", "grip")}

    def row(n: int) -> Row:
        name = list(angles)[n % 4]
        return {
            "robot": robot,
            "seq": 4000 + n,
            "t_ms": start_ms + n * 50 + noise.randrange(4),
            "joint": name,
            "angle_deg": angles[name](),
            "moving": abs(angles[name].speed) > 0.5,
        }

    return row


def motion(robot: str, noise: random.Random, start_ms: int) -> Callable[[int], Row]:
    turn, speed = Drift(noise, 0, 40, 1), Drift(noise, 0.4, 0.4, 2)
    temperature = Drift(noise, 31, 3, 1)
    at = {"x_m": noise.uniform(-5, 5), "y_m": noise.uniform(-5, 5), "heading_deg": noise.uniform(0, 360)}

    def row(n: int) -> Row:
        rate, forward = turn(), speed()
        at["heading_deg"] = (at["heading_deg"] + rate * 0.1) % 360
        at["x_m"] += forward * 0.1 * math.cos(math.radians(at["heading_deg"]))
        at["y_m"] += forward * 0.1 * math.sin(math.radians(at["heading_deg"]))
        return {
            "robot": robot,
            "seq": n,
            "t_ms": start_ms + n * 100 + noise.randrange(6),
            "frame": "map",
            "pose": {key: round(value, 2) for key, value in at.items()},
            "speed_m_s": forward,
            "turn_deg_s": rate,
            "gravity_m_s2": round(noise.gauss(9.81, 0.03), 2),
            "imu_temperature_c": temperature(),
            "source": "wheels+imu",
        }

    return row


def status(robot: str, noise: random.Random, start_ms: int) -> Callable[[int], Row]:
    current, load = Drift(noise, 1.4, 1.2, 2), Drift(noise, 0.6, 0.5, 2)
    heat, rssi = Drift(noise, 52, 8, 1), Drift(noise, -58, 14, 0)
    motors = [Drift(noise, 120, 110, 0) for _ in range(2)]

    def row(n: int) -> Row:
        used = n % 5000 / 5000
        volts = 12.4 - used + noise.gauss(0, 0.01)
        return {
            "robot": robot,
            "fleet": "rect",
            "t_ms": start_ms + n * 1000 + noise.randrange(20),
            "uptime_s": 371 + n,
            "mode": "driving" if n // 60 % 3 else "waiting",
            "battery": {"volts": round(volts, 2), "amps": current(), "percent": 97 - int(80 * used), "charging": False},
            "cpu": {"load": load(), "temperature_c": heat(), "throttled": False},
            "radio": {"name": "hci0", "rssi_dbm": int(rssi()), "connected": ["base-station", "wombat-2"]},
            "motors": [
                {"side": side, "rpm": int(drift()), "fault": None}
                for side, drift in zip(("left", "right"), motors, strict=True)
            ],
            "errors": [],
        }

    return row


def weather() -> list[str]:
    """Returns four years of days in Seattle from a file of vega_datasets; importing the package would require
    pandas."""
    package = importlib.util.find_spec("vega_datasets")
    if package is None or package.origin is None:
        raise SystemExit("codecs: vega_datasets is missing; run scripts/setup bench")
    with open(Path(package.origin).parent / "_data" / "seattle-weather.csv", newline="") as file:
        words = ("date", "weather")
        return [
            compact({key: text if key in words else float(text) for key, text in row.items()})
            for row in csv.DictReader(file)
        ]


def compact(row: Row) -> str:
    return json.dumps(row, separators=(",", ":"))


def recordings(count: int) -> dict[str, tuple[list[str], list[str]]]:
    """Returns for each kind the messages for training and those to measure, from another robot and run or other
    years."""
    kinds = {"joint": joint, "motion": motion, "status": status}

    def run(kind: str, number: int, day: int) -> list[str]:
        noise = random.Random(f"{kind} {number}")
        row = kinds[kind](f"wombat-{number}", noise, START_MS + day * DAY_MS)
        return [compact(row(number * 7000 + n)) for n in range(count)]

    made = {kind: (run(kind, 1, day=0) + run(kind, 2, day=3), run(kind, 3, day=9)) for kind in kinds}
    days = weather()
    half = len(days) // 2
    return made | {"weather": (days[:half], days[half:])}
