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
import video_picture
from pairs import INTERVAL_MS, ble_pair_endpoints, room
from PIL import Image
from robots import RobotError
from table import Table
from traffic import percentile

#: The length of the packets, and the rate of the camera.
RATES = {"34 kB/s": (27, 15), "100 kB/s": (251, 25)}
SIZES = {"320x240": (320, 240), "640x480": (640, 480), "640x480, moving": (640, 480)}
SENDERS = {
    "video": {"video": True},
    "adaptive, JPEG": {},
    "adaptive, WebP": {"lossy_format": "webp"},
    "fixed, JPEG 30": {"codec": "jpeg:30"},
}
#: The case whose frames are drawn, and what its senders are called.
DRAWN = ("34 kB/s", "640x480, moving")
CAPTIONS = {"adaptive, JPEG": "Separate pictures", "video": "Video"}
DEFAULTS = {"codec": None, "lossy_format": "jpeg", "video": False}
PHOTOGRAPHS = ["coffee.png", "chelsea.png", "rocket.jpg", "astronaut.png"]
SECONDS = 40
# Frames that arrive earlier are not counted.
SETTLED_S = 5
TARGET = {"frames": 5, "age_ms": 600, "urgent_ms": 100}
#: Of a video of 640x480: frames per second and SSIM, by the link.
VIDEO_TARGETS = {"34 kB/s": (14, 0.88), "100 kB/s": (24, 0.94)}
VIDEO_TARGET = {"age_ms": 400, "urgent_ms": 60}


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
    with tempfile.TemporaryDirectory() as kept:
        halves = []
        for rate, (pdu, frames_per_s) in RATES.items():
            for size in SIZES:
                for sender in SENDERS:
                    frame = Path(kept) / f"{sender}.png"
                    outcome = measured(pdu, frames_per_s, size, sender, frame)
                    table.add(rate, size, sender, *cells(outcome, rate, size, sender))
                    print("  " + " | ".join(table.rows[-1]), flush=True)
                    if (rate, size) == DRAWN and sender in CAPTIONS:
                        halves.append((caption(outcome, sender), frame.rename(frame.with_suffix(".kept.png"))))
        video_picture.draw(sorted(halves))
    table.notes = [
        f"The simulated air (condition desk, interval {INTERVAL_MS} ms; link-layer packets of 27 and of 251 bytes), "
        "`config/simulation.json5`. A camera of 15 Hz (25 Hz at 100 kB/s) pans over photographs of scikit-image "
        "(`coffee`, `chelsea`, `rocket`, `astronaut`, tiled) by 3 and 2 pixels per frame; each value has noise of up "
        "to 3 of 255. Moving: two discs, of a third and a quarter of the height, move before it by 7 and 9 pixels per "
        "frame, and the light falls and rises by 30 % within 15 s. Camera and watcher are in one process, each with "
        "its own router, so that one clock measures the ages, which include the encoding. The frames of the first "
        f"{SETTLED_S} s do not count. SSIM: luma, windows of 8x8, of every eighth frame at the camera's size (smaller "
        "ones enlarged, bicubic), compared with the picture without noise. Urgent: a number as JSON every 50 ms from "
        "the camera's program. Changes: how often an adaptive stream changed its step.",
        f"Target for adaptive streams: {TARGET['frames']} frames/s, age p99 below {TARGET['age_ms']} ms, urgent p99 "
        f"below {TARGET['urgent_ms']} ms, no urgent message lost. For video: 14 frames/s and SSIM 0.88 at 34 kB/s, 24 "
        f"and 0.94 at 100 kB/s, age p99 below {VIDEO_TARGET['age_ms']} ms, urgent p99 below "
        f"{VIDEO_TARGET['urgent_ms']} ms.",
    ]
    return table


def caption(outcome: Outcome, sender: str) -> str:
    figures = f"{outcome.frames_per_s:.0f} per second, {outcome.kb_per_s:.0f} kB/s, SSIM {outcome.ssim:.2f}"
    return f"{CAPTIONS[sender]}: {figures}"


def measured(pdu: int, frames_per_s: int, size: str, sender: str, kept: Path | None = None) -> Outcome:
    """Returns the outcome of one run. The last frame that was examined is written to `kept`, as it is shown."""
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
                "moves": size.endswith("moving"),
                **DEFAULTS,
                **SENDERS[sender],
            }
            command = [os.environ["RECT_STREAM_LOAD"], json.dumps(task)]
            done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS + 60)
        if done.returncode:
            raise RobotError(done.stderr)
        report = json.loads(done.stdout)
        if kept is not None:
            last = examined(report, folder / "frames")[-1]
            shown = read(folder / "frames" / str(last["index"]), last["encoding"], SIZES[size])
            Image.fromarray(shown).save(kept)
        return outcome_of(report, SIZES[size], folder / "frames")


def examined(report: dict, frames: Path) -> list[dict]:
    """Returns the frames whose pictures were written."""
    settled = (frame for frame in report["received_frames"] if frame["at_s"] >= SETTLED_S)
    return [frame for frame in settled if (frames / str(frame["index"])).exists()]


def outcome_of(report: dict, size: tuple[int, int], frames: Path) -> Outcome:
    settled = [frame for frame in report["received_frames"] if frame["at_s"] >= SETTLED_S]
    if not settled:
        raise RobotError("no frame arrived")
    span_s = SECONDS - SETTLED_S
    similarities = [
        ssim(raw(frames / f"{frame['index']}.clean", size), read(frames / str(frame["index"]), frame["encoding"], size))
        for frame in examined(report, frames)
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


def cells(outcome: Outcome, rate: str, size: str, sender: str) -> list[str]:
    age_p99 = percentile(outcome.ages_ms, 0.99)
    urgent_p99 = percentile(outcome.urgent_ms, 0.99)
    faults = []
    if sender.startswith("adaptive"):
        if outcome.frames_per_s < TARGET["frames"]:
            faults.append("few frames")
        if age_p99 > TARGET["age_ms"]:
            faults.append("old frames")
    if sender == "video":
        frames_per_s, similarity = VIDEO_TARGETS[rate]
        if outcome.frames_per_s < frames_per_s:
            faults.append("few frames")
        if outcome.ssim < similarity:
            faults.append("coarse")
        if age_p99 > VIDEO_TARGET["age_ms"]:
            faults.append("old frames")
    if urgent_p99 > (VIDEO_TARGET if sender == "video" else TARGET)["urgent_ms"]:
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


def raw(file: Path, size: tuple[int, int]) -> numpy.ndarray:
    return numpy.asarray(Image.frombytes("RGB", size, file.read_bytes()))


def read(file: Path, encoding: str, size: tuple[int, int]) -> numpy.ndarray:
    of_video = re.fullmatch(r"application/octet-stream;picture;rgb8;(\d+)x(\d+)", encoding)
    if of_video:
        picture = Image.frombytes("RGB", (int(of_video[1]), int(of_video[2])), file.read_bytes())
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
