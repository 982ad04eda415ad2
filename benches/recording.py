"""Measures `rect record` and `rect replay`: processor time, memory, size beside the reference writer, timing, and
urgent messages of the recorded robot, also while the recorder's disk stands still."""

import os
import random
import signal
import statistics
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rect
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from robots import free_port
from routers import own_kb
from table import Table
from traffic import percentile

SECONDS = 20
#: How often the urgent messages are measured without a recorder, with one, and with a slow disk.
ROUNDS = 3
TOPICS = 20
RATE = 50
PICTURES = 10
PICTURE_BYTES = 10_000
TICKS = os.sysconf("SC_CLK_TCK")
#: Lets each synchronisation of a file take ten seconds.
STALLED_DISK = ["strace", "-f", "--seccomp-bpf", "-o", "/dev/null", "-e", "inject=fsync:delay_enter=10000000"]


@contextmanager
def recorder(endpoint: str, output: Path, *through: str) -> Iterator[subprocess.Popen[str]]:
    """Runs `rect record` until the end of the block, and waits until the file is complete."""
    command = [*through, os.environ["RECT_TOOL"], "record", "wombat-1/**", "--as", "recorder", "--router", endpoint]
    command += ["--output", str(output)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if "recording wombat-1/**" in line:
                break
        # Otherwise a full pipe would stop the process.
        threading.Thread(target=process.stderr.read).start()
        yield process
        os.kill(recording(process.pid) if through else process.pid, signal.SIGINT)
        assert process.wait(180) == 0


def recording(tracer: int) -> int:
    """Returns the process that a tracer runs."""
    return int(Path(f"/proc/{tracer}/task/{tracer}/children").read_text().split()[0])


def publish(robot: rect.Robot, *, is_recorded: bool) -> int:
    """Publishes telemetry, pictures and urgent messages for a time; returns the number of messages."""
    publishers = [robot.publisher(f"sensor/{number}") for number in range(TOPICS)]
    camera, stop = robot.publisher("camera"), robot.publisher("stop", urgency="urgent")
    stop.wait_for_subscriber(10)
    if is_recorded:
        publishers[0].wait_for_subscriber(10)
    noise = random.Random(1)
    picture = rect.Payload(b"\xff\xd8" + noise.randbytes(PICTURE_BYTES), "image/jpeg")
    started = time.monotonic()
    for tick in range(SECONDS * RATE):
        time.sleep(max(0.0, started + tick / RATE - time.monotonic()))
        for number, publisher in enumerate(publishers):
            publisher.publish({"tick": tick, "value": noise.random(), "unit": f"V{number}"})
        if tick % (RATE // PICTURES) == 0:
            camera.publish(picture)
        stop.publish(time.monotonic())
    return SECONDS * (TOPICS * RATE + PICTURES + RATE)


@contextmanager
def urgent_ms(endpoint: str) -> Iterator[list[float]]:
    """Collects how long urgent messages take to another robot, in milliseconds."""
    taken: list[float] = []
    with rect.connect("wombat-2", endpoints=[endpoint]) as other:
        other.wait_for_peer("wombat-1", 10)

        def on_stop(message: rect.Message) -> None:
            taken.append(1000 * (time.monotonic() - message.value))

        with other.subscribe("wombat-1/stop", callback=on_stop):
            yield taken


def processor_ms(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) * 1000 / TICKS


def times(file: Path) -> dict[tuple[str, int], int]:
    """Returns when each message was recorded, in nanoseconds, by its topic and its place among those of the topic."""
    found: dict[tuple[str, int], int] = {}
    places: dict[str, int] = {}
    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            if "/@rect/" in channel.topic:
                continue
            place = places[channel.topic] = places.get(channel.topic, -1) + 1
            found[channel.topic, place] = message.log_time
    return found


def written_by_reference(file: Path, copy: Path) -> float:
    """Writes the same messages with the reference writer; returns its processor time in milliseconds."""
    with file.open("rb") as stream:
        read = list(make_reader(stream).iter_messages(log_time_order=False))
    started = time.process_time()
    with copy.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start()
        channels: dict[int, int] = {}
        for schema, channel, message in read:
            if channel.id not in channels:
                known = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, known, channel.metadata
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.finish()
    return (time.process_time() - started) * 1000


def run() -> Table:
    table = Table(
        "Recording 20 topics at 50 Hz and ten pictures of 10 kB per second, and replaying that",
        ["what", "messages", "processor time", "private memory", "size", "urgent p50", "p99"],
    )
    with tempfile.TemporaryDirectory() as folder:
        file, replayed = Path(folder) / "match.mcap", Path(folder) / "replayed.mcap"
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        stalled = Path(folder) / "stalled.mcap"
        alone, beside, beside_stalled = [], [], []
        with rect.connect("wombat-1", listen=[endpoint]) as robot:
            for _ in range(ROUNDS):
                with urgent_ms(endpoint) as taken:
                    publish(robot, is_recorded=False)
                alone.append(taken)
                file.unlink(missing_ok=True)
                with urgent_ms(endpoint) as taken, recorder(endpoint, file) as process:
                    before = processor_ms(process.pid)
                    published = publish(robot, is_recorded=True)
                    # Messages that are on the way arrive.
                    time.sleep(1)
                    used = (processor_ms(process.pid) - before) / (SECONDS + 1)
                    memory = own_kb(process.pid)
                beside.append(taken)
                stalled.unlink(missing_ok=True)
                with urgent_ms(endpoint) as taken, recorder(endpoint, stalled, *STALLED_DISK) as process:
                    publish(robot, is_recorded=True)
                    time.sleep(1)
                    stalled_memory = own_kb(recording(process.pid))
                beside_stalled.append(taken)
        original = times(file)
        size = file.stat().st_size
        table.add("no recorder", "", "", "", "", *urgent_cells(alone))
        cells = f"{used:.1f} ms/s", f"{memory / 1000:.1f} MB", per_hour(size)
        table.add("rect record", len(original), *cells, *urgent_cells(beside))
        cells = len(times(stalled)), "", f"{stalled_memory / 1000:.1f} MB", ""
        table.add("rect record, each sync takes 10 s", *cells, *urgent_cells(beside_stalled))
        copy = Path(folder) / "copy.mcap"
        used = written_by_reference(file, copy) / SECONDS
        table.add(
            "reference writer (Python)", len(original), f"{used:.1f} ms/s", "", per_hour(copy.stat().st_size), "", ""
        )

        endpoint = f"tcp/127.0.0.1:{free_port()}"
        command = [os.environ["RECT_TOOL"], "replay", str(file), "--wait", "--listen", endpoint]
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as replay:
            time.sleep(1)
            with recorder(endpoint, replayed) as process:
                assert replay.wait(SECONDS + 30) == 0
                time.sleep(1)
        again = times(replayed)
        table.add("rect replay", len(again), "", "", "", "", "")
    # The first message tells how the two clocks differ.
    first = min(original, key=lambda key: original[key])
    shift = again[first] - original[first]
    off_ms = [abs(again[key] - original[key] - shift) / 1e6 for key in original if key in again]
    table.notes = [
        f"Published: {published} messages in {SECONDS} s; {published - len(original)} of them were not recorded. "
        f"Replayed messages arrive {percentile(off_ms, 0.5):.2f} ms (p50) and {percentile(off_ms, 0.99):.2f} ms (p99) "
        "from their place in the recording, measured by a second recording; target: 2 ms (p99).",
        "Urgent: how long an urgent message of the recorded robot takes to another one, in one process of Python, "
        f"beside the other messages; medians of {ROUNDS} alternating rounds, with the lowest and the highest. The "
        "other figures are those of the last round. The recorder whose disk stands still runs under strace, which "
        "delays each fsync.",
    ]
    return table


def urgent_cells(rounds: list[list[float]]) -> list[str]:
    """Returns p50 and p99 of the rounds."""
    cells = []
    for share in (0.5, 0.99):
        found = [percentile(taken_ms, share) for taken_ms in rounds]
        cells.append(f"{statistics.median(found):.2f} ms ({min(found):.2f} to {max(found):.2f})")
    return cells


def per_hour(size: int) -> str:
    return f"{size / SECONDS * 3600 / 1e6:.0f} MB/h"
