"""Measures a camera over a slow link, adaptive and fixed, and concurrent urgent messages of the same program."""

import io
import json
import os
import re
import subprocess
import tempfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy
from pairs import INTERVAL_MS, ble_pair_endpoints, room
from PIL import Image
from robots import RobotError
from table import Table
from traffic import percentile

#: The length of the packets, and the rate of the camera.
RATES = {"34 kB/s": (27, 15), "100 kB/s": (251, 25)}
SIZES = {"320x240": (320, 240), "640x480": (640, 480)}
SENDERS = {
    "video": {"video": True},
    "adaptive, JPEG": {},
    "adaptive, WebP": {"lossy_format": "webp"},
    "fixed, JPEG 30": {"codec": "jpeg:30"},
}
DEFAULTS = {"codec": None, "lossy_format": "jpeg", "video": False}
PHOTOGRAPHS = ["coffee.png", "chelsea.png", "rocket.jpg", "astronaut.png"]
SECONDS = 40
# Frames that arrive earlier are not counted.
SETTLED_S = 5
TARGET = {"frames": 5, "age_ms": 600, "urgent_ms": 100}


@dataclass
class Outcome:
    frames_per_s: float
    kb_per_s: float
    ages_ms: list[float]
    age_error_ms: float
    skipped: int
    ssim: float
    level: str
    changes: int
    urgent_sent: int
    urgent_ms: list[float]
    encode_ms: float


def run() -> Table:
    table = Table(
        "A camera over a slow link; old frames are dropped",
        [
            "link",
            "picture",
            "sender",
            "frames/s",
            "kB/s",
            "age p50",
            "p99",
            "SSIM",
            "at the end",
            "changes",
            "skipped",
            "encoding",
            "urgent arrived",
            "urgent p99",
            "outcome",
        ],
    )
    for rate, (pdu, frames_per_s) in RATES.items():
        for size in SIZES:
            for sender in SENDERS:
                outcome = measured(pdu, frames_per_s, size, sender)
                table.add(rate, size, sender, *cells(outcome, size, sender))
                print("  " + " | ".join(table.rows[-1]), flush=True)
    table.notes = [
        f"The simulated air (condition desk, interval {INTERVAL_MS} ms; link-layer packets of 27 and of 251 bytes), "
        "`config/simulation.json5`. A camera of 15 Hz pans over photographs of scikit-image (`coffee`, `chelsea`, "
        "`rocket`, `astronaut`, tiled) by 3 and 2 pixels per frame. Camera and watcher are in one process, each with "
        "its own router, so that one clock measures the ages, which include the encoding. The frames of the first "
        f"{SETTLED_S} s do not count. SSIM: luma, windows of 8x8, of {EXAMINED} frames at the camera's size "
        "(smaller ones enlarged, bicubic). Urgent: a number as JSON every 50 ms from the camera's program. "
        "Changes: how often an adaptive stream changed its step.",
        f"Target for adaptive streams: {TARGET['frames']} frames/s, age p99 below {TARGET['age_ms']} ms, urgent p99 "
        f"below {TARGET['urgent_ms']} ms, no urgent message lost.",
    ]
    return table


def measured(pdu: int, frames_per_s: int, size: str, sender: str) -> Outcome:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        panorama = panorama_of(*SIZES[size])
        (folder / "panorama").write_bytes(panorama.tobytes())
        (folder / "frames").mkdir()
        with room(pdu) as air:
            near, far = ble_pair_endpoints(air)
            task = {
                "near": near,
                "far": far,
                "panorama": str(folder / "panorama"),
                "panorama_size": [panorama.shape[1], panorama.shape[0]],
                "size": SIZES[size],
                "seconds": SECONDS,
                "frames": str(folder / "frames"),
                "frames_per_s": frames_per_s,
                **DEFAULTS,
                **SENDERS[sender],
            }
            command = [os.environ["RECT_STREAM_LOAD"], json.dumps(task)]
            done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS + 60)
        if done.returncode:
            raise RobotError(done.stderr)
        return outcome_of(json.loads(done.stdout), panorama, SIZES[size], folder / "frames")


def outcome_of(report: dict, panorama: numpy.ndarray, size: tuple[int, int], frames: Path) -> Outcome:
    settled = [frame for frame in report["received_frames"] if frame["at_s"] >= SETTLED_S]
    if not settled:
        raise RobotError("no frame arrived")
    span_s = SECONDS - SETTLED_S
    similarities = [
        ssim(view(panorama, size, frame["index"]), read(file, frame["encoding"], size))
        for frame in settled
        if (file := frames / str(frame["index"])).exists()
    ]
    age_errors_ms = [
        abs(frame["age_ms"] - report["encode_ms"] - frame["reported_age_ms"])
        for frame in settled
        if frame["reported_age_ms"]
    ]
    group = report["status"]["groups"][0]
    return Outcome(
        frames_per_s=len(settled) / span_s,
        kb_per_s=sum(frame["bytes"] for frame in settled) / span_s / 1000,
        ages_ms=[frame["age_ms"] for frame in settled],
        age_error_ms=percentile(age_errors_ms, 0.5),
        skipped=sum(frame["skipped"] for frame in settled),
        ssim=float(numpy.mean(similarities)),
        level=level_text(group["step"], group["video"]),
        changes=group["changes"],
        urgent_sent=report["urgent_sent"],
        urgent_ms=report["urgent_ms"],
        encode_ms=report["encode_ms"],
    )


def cells(outcome: Outcome, size: str, sender: str) -> list[str]:
    age_p99 = percentile(outcome.ages_ms, 0.99)
    urgent_p99 = percentile(outcome.urgent_ms, 0.99)
    faults = []
    if sender.startswith("adaptive"):
        if outcome.frames_per_s < TARGET["frames"]:
            faults.append("few frames")
        if age_p99 > TARGET["age_ms"]:
            faults.append("old frames")
    if urgent_p99 > TARGET["urgent_ms"]:
        faults.append("urgent late")
    if len(outcome.urgent_ms) < outcome.urgent_sent:
        faults.append("urgent lost")
    return [
        f"{outcome.frames_per_s:.1f}",
        f"{outcome.kb_per_s:.1f}",
        f"{percentile(outcome.ages_ms, 0.5):.0f} ms",
        f"{age_p99:.0f} ms",
        f"{outcome.ssim:.3f}",
        outcome.level,
        str(outcome.changes),
        str(outcome.skipped),
        f"{outcome.encode_ms:.0f} ms",
        f"{len(outcome.urgent_ms)}/{outcome.urgent_sent}",
        f"{urgent_p99:.0f} ms",
        ", ".join(faults) or "ok",
    ]


def level_text(level: dict | None, video: dict | None) -> str:
    if video is not None:
        size = "" if video["quarters"] == 4 else f" at {video['quarters']}/4"
        return f"{video['bytes_per_s'] / 1000:.0f} kB/s{size}"
    if level is None:
        return ""
    coding = level["coding"]
    quality = coding if isinstance(coding, str) else f"quality {coding['lossy']}"
    return quality if level["quarters"] == 4 else f"{quality} at {level['quarters']}/4"


def panorama_of(width: int, height: int) -> numpy.ndarray:
    """Returns photographs side by side, 1.5 times as large as the camera's view."""
    # Only the photographs of the package are used; its dependencies are not installed.
    folder = Path(find_spec("skimage").origin).parent / "data"
    tiles = []
    for name in PHOTOGRAPHS:
        with Image.open(folder / name) as photograph:
            tile = photograph.convert("RGB").resize((width * 3 // 4, height * 3 // 4), Image.LANCZOS)
            tiles.append(numpy.asarray(tile))
    return numpy.ascontiguousarray(numpy.vstack([numpy.hstack(tiles[:2]), numpy.hstack(tiles[2:])]))


def view(panorama: numpy.ndarray, size: tuple[int, int], index: int) -> numpy.ndarray:
    """Returns the camera's view of a frame, as `examples/stream_load.rs` calculates it."""
    (width, height), (panorama_height, panorama_width) = size, panorama.shape[:2]
    left, top = to_and_fro(index * 3, panorama_width - width), to_and_fro(index * 2, panorama_height - height)
    return panorama[top : top + height, left : left + width]


def to_and_fro(distance: int, span: int) -> int:
    return abs(span - distance % (span * 2)) if span else 0


def read(file: Path, encoding: str, size: tuple[int, int]) -> numpy.ndarray:
    raw = re.fullmatch(r"application/octet-stream;picture;rgb8;(\d+)x(\d+)", encoding)
    if raw:
        picture = Image.frombytes("RGB", (int(raw[1]), int(raw[2])), file.read_bytes())
    else:
        picture = Image.open(io.BytesIO(file.read_bytes())).convert("RGB")
    return numpy.asarray(picture if picture.size == size else picture.resize(size, Image.BICUBIC))


def ssim(one: numpy.ndarray, other: numpy.ndarray) -> float:
    """Returns the structural similarity (Wang et al. 2004) of the luma, the mean over all windows of 8x8."""
    x, y = (numpy.asarray(Image.fromarray(part).convert("L"), dtype=float) for part in (one, other))
    mean_x, mean_y = windows(x), windows(y)
    spread_x, spread_y = windows(x * x) - mean_x**2, windows(y * y) - mean_y**2
    common = windows(x * y) - mean_x * mean_y
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    above = (2 * mean_x * mean_y + c1) * (2 * common + c2)
    below = (mean_x**2 + mean_y**2 + c1) * (spread_x + spread_y + c2)
    return float(numpy.mean(above / below))


def windows(values: numpy.ndarray, side: int = 8) -> numpy.ndarray:
    sums = numpy.pad(values.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    return (sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]) / side**2
