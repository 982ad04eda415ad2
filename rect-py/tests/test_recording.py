"""Tests that stock readers open the files of `rect record`, also of a killed one, and recordings of the library:
`scripts/test-python -k recording`

RECT_KILLS=1000 kills a thousand recorders in place of 20, which takes a quarter of an hour.
"""

from __future__ import annotations

import itertools
import json
import os
import random
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import av
import numpy
import pytest
import rect
import zenoh
from conftest import Pair, free_port, repeating, until
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory
from programs import DEADLINE, Routers, program

JPEG = b"\xff\xd8" + bytes(5000)
#: How many recorders are killed in one round.
KILLED = 20
#: The rounds of this run.
ROUNDS = max(1, int(os.environ.get("RECT_KILLS", KILLED)) // KILLED)


def tool(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [program("RECT_TOOL", "rect"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE)


@contextmanager
def recorder(endpoint: str, output: Path) -> Iterator[subprocess.Popen[str]]:
    """Runs `rect record` at a program of wombat-1."""
    options = ["--as", "recorder", "--router", endpoint, "--output", str(output)]
    command = [program("RECT_TOOL", "rect"), "record", "wombat-1/**", *options]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def until_recording(process: subprocess.Popen[str]) -> None:
    assert process.stderr
    for line in process.stderr:
        if "recording wombat-1/**" in line:
            return
    raise AssertionError("rect record has ended")


@contextmanager
def publishing(robot: rect.Robot) -> Iterator[None]:
    """Publishes numbered messages, and a picture now and then, on a thread."""
    numbers = itertools.count()

    def publish() -> None:
        number = next(numbers)
        robot.publish("pose", {"n": number, "at": {"x": number / 2}})
        if number % 50 == 0:
            robot.publish("camera", rect.Payload(JPEG, "image/jpeg"))

    with repeating(0.005, publish):
        yield


def messages(file: Path) -> list[tuple[Any, Any, Any]]:
    """Reads a file with the stock reader, which seeks to the summary at its end."""
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_summary() is not None, "it has no summary"
        return list(reader.iter_messages())


def test_stock_reader_opens_a_recording(tmp_path: Path) -> None:
    endpoint, file = f"tcp/127.0.0.1:{free_port()}", tmp_path / "match.mcap"
    with rect.connect("wombat-1", listen=[endpoint]) as robot, recorder(endpoint, file) as process:
        until_recording(process)
        publisher = robot.publisher("pose")
        publisher.wait_for_subscriber(DEADLINE)
        with publishing(robot):
            time.sleep(2)
        time.sleep(0.5)
        process.terminate()
        assert process.wait(DEADLINE) == 0
    read = messages(file)
    poses = [(channel, message) for schema, channel, message in read if channel.topic == "wombat-1/pose"]
    assert len(poses) > 100
    numbers = [json.loads(message.data)["n"] for _, message in poses]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    (schema,) = {schema.data for schema, channel, _ in read if channel.topic == "wombat-1/pose"}
    fields = json.loads(schema)["properties"]
    assert fields["at"]["properties"] == {"x": {"type": "number"}}
    assert poses[0][0].message_encoding == "json"
    # As viewers do: the schema in the file describes the pictures.
    with file.open("rb") as stream:
        decoded = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["wombat-1/camera"])
        pictures = [(schema and schema.name, picture.format, picture.data) for schema, _, _, picture in decoded]
    assert pictures and set(pictures) == {("foxglove.CompressedImage", "jpeg", JPEG)}


def refused(schema: Any, name: str) -> list[str]:
    """Returns what viewers refuse in a schema: a root that is not an object, or fields and items of unknown type."""
    if schema.get("type") != "object" or not isinstance(schema.get("properties"), dict):
        return [f"{name} is not an object: {schema}"]
    problems = []
    for field, of_field in schema["properties"].items():
        inner = of_field["items"] if of_field.get("type") == "array" else of_field
        if inner.get("type") == "object":
            problems += refused(inner, f"{name}.{field}")
        elif inner.get("type") not in ("boolean", "number", "string"):
            problems.append(f"{name}.{field} is {of_field}")
    return problems


def shown(file: Path) -> dict[str, list[Any]]:
    """Returns the messages that viewers show, by topic: objects, and the names of the schemas of pictures.

    Verifies that viewers accept all of their schemas.
    """
    found: dict[str, list[Any]] = {}
    for schema, channel, message in messages(file):
        if channel.message_encoding not in ("json", "protobuf"):
            continue
        assert schema, channel
        if channel.message_encoding == "json":
            assert schema.encoding == "jsonschema" and not refused(json.loads(schema.data), schema.name)
            value = json.loads(message.data)
            assert isinstance(value, dict)
        else:
            value = schema.name
        found.setdefault(channel.topic, []).append(value)
    return found


def test_recording_of_the_demo_is_shown_by_viewers(routers: Routers, tmp_path: Path) -> None:
    from two_wombats import (  # type: ignore[import-not-found, unused-ignore]
        MESSAGES,
        PHOTOGRAPHS,
        json_both_ways,
        photographs,
        question_and_answer,
    )

    file = tmp_path / "demo.mcap"
    with routers.tool("wombat-2", "record", "wombat-1/**", "wombat-2/**", "--output", str(file)) as recorder:
        recorder.until("recording wombat-1/**")
        with routers.robots["wombat-1"].session() as here, routers.robots["wombat-2"].session() as there:
            json_both_ways(here, there)
            question_and_answer(here, there)
            photographs(here, there)
        running = rect.Recording(tmp_path / "demo.segments")

        def pictures() -> int:
            return sum(message.payload.encoding == "image/jpeg" for message in running)

        until(lambda: pictures() == len(PHOTOGRAPHS), pictures)
        recorder.process.terminate()
        assert recorder.ends() == 0
    found = shown(file)
    for robot in ("wombat-1", "wombat-2"):
        angles = [value["n"] for value in found[f"{robot}/arm/angle"] if "n" in value]
        assert sorted(set(angles)) == list(range(MESSAGES))
    assert found["wombat-1/camera"].count("foxglove.CompressedImage") >= len(PHOTOGRAPHS)
    assert any("/@rect/link/" in topic for topic in found)
    assert "wombat-2/@rect/events" in found


def test_values_of_every_form_are_shown_and_read(tmp_path: Path) -> None:
    file = tmp_path / "match.mcap"
    array = numpy.array([0.5, numpy.nan, -numpy.inf], numpy.float32)
    values: dict[str, tuple[Any, Any]] = {
        "angle": (12.5, {"value": 12.5}),
        "on": (True, {"value": True}),
        "nothing": (None, {"value": None}),
        "list": ([1, 2], {"value": [1, 2]}),
        "nested": ({"table": [[1], []], "empty": []}, {"table": [[1], []], "empty": []}),
        "text": ("open", {"value": "open"}),
        "cbor": (rect.Cbor({1: 2, "blob": b"abc", "x": numpy.inf}), {"1": 2, "blob": {"bytes": 3}, "x": "Infinity"}),
        "array": (array, {"value": [0.5, "NaN", "-Infinity"]}),
    }
    listen = [f"tcp/127.0.0.1:{free_port()}"]
    with rect.connect("wombat-1", listen=listen) as robot, robot.record(file, "wombat-1/**") as recorder:
        for topic, (value, _) in values.items():
            robot.publish(topic, value)
        robot.publish("table", numpy.array([[1, 2], [3, 4]]))
        until_recorded(recorder, len(values) + 1)
    found = shown(file)
    assert {topic: found[f"wombat-1/{topic}"] for topic in values} == {
        topic: [object] for topic, (_, object) in values.items()
    }
    recording = rect.Recording(file)
    read = {message.topic: message.value for message in recording}
    assert numpy.array_equal(read.pop("array"), array, equal_nan=True)
    assert read.pop("table").tolist() == [[1, 2], [3, 4]]
    assert read == {
        topic: value.value if isinstance(value, rect.Cbor) else value
        for topic, (value, _) in values.items()
        if topic in read
    }
    columns = recording.numbers("wombat-1/array")
    assert list(columns) == ["time_s", "0", "1", "2"]
    assert columns["0"][0] == 0.5 and numpy.isnan(columns["1"][0]) and columns["2"][0] == -numpy.inf
    assert list(recording.numbers("wombat-1/table")) == ["time_s", "0.0", "0.1", "1.0", "1.1"]
    assert recording.numbers("wombat-1/cbor")["x"][0] == numpy.inf


def ros_file(file: Path) -> None:
    """Writes a file as another program does: the last message is the first, and the others are mixed."""
    with file.open("wb") as stream:
        writer = Writer(stream, chunk_size=200)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data")
        channel = writer.register_channel("/angle", "cdr", schema, {"offered_qos_profiles": "none"})
        numbers = writer.register_schema("number", "jsonschema", b'{"type": "object", "properties": {}}')
        number = writer.register_channel("a/number", "json", numbers)
        writer.add_metadata("weather", {"sky": "grey"})
        writer.add_attachment(1, 2, "map.pgm", "image/x-portable-graymap", bytes(1000))
        for n in range(100):
            at = (99 + n * 37) % 100
            data = json.dumps({"n": at}).encode()
            writer.add_message(number, log_time=(50 + at) * 10**9, data=data, publish_time=0, sequence=at)
            writer.add_message(channel, log_time=(50 + at) * 10**9, data=bytes(12), publish_time=7, sequence=at)
        writer.finish()


def content(file: Path) -> list[Any]:
    """Returns what a file contains, in the order of time."""
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        read = [
            (
                (message.log_time, channel.topic),
                schema and (schema.name, schema.encoding, schema.data),
                (channel.message_encoding, channel.metadata),
                (message.publish_time, message.sequence, message.data),
            )
            for schema, channel, message in reader.iter_messages()
        ]
        extras = [
            reader.get_header().profile,
            [(record.name, record.metadata) for record in reader.iter_metadata()],
            [(one.name, one.media_type, one.log_time, one.create_time, one.data) for one in reader.iter_attachments()],
        ]
        return [extras, *sorted(read, key=lambda message: message[0])]


def test_files_of_other_programs_are_read_by_time_and_copied_whole(tmp_path: Path) -> None:
    file, copy = tmp_path / "ros.mcap", tmp_path / "copy.mcap"
    ros_file(file)
    for command in ("cut", "merge"):
        copied = tool("recording", command, str(file), "--output", str(copy))
        assert copied.stdout == f"{copy}: 200 messages\n", copied.stderr
        assert content(copy) == content(file)
        copy.unlink()
    cut = tool("recording", "cut", str(file), "--from", "10s", "--until", "20s", "--output", str(copy))
    assert cut.stdout == f"{copy}: 22 messages\n", cut.stderr
    exported = tool("recording", "export", str(file), "--format", "csv", "--topic", "a/*")
    assert [row.split(",")[-1] for row in exported.stdout.splitlines()[1:]] == [str(n) for n in range(100)]
    recording = rect.Recording(file)
    assert [message.value["n"] for message in recording] == list(range(100))
    assert recording.numbers("a/number")["time_s"].tolist() == list(range(100))


def test_damaged_recording_is_recovered(tmp_path: Path) -> None:
    file, saved = tmp_path / "ros.mcap", tmp_path / "saved.mcap"
    ros_file(file)
    damaged = bytearray(file.read_bytes())
    # In the content of one of the first chunks.
    chunks = [found.end() for found in re.finditer(b"zstd", damaged)]
    damaged[chunks[5] + 30] ^= 1
    for data in (bytes(damaged), bytes(damaged[: len(damaged) // 2])):
        file.write_bytes(data)
        merged = tool("recording", "merge", str(file), "--output", str(saved))
        assert merged.returncode == 1 and "rect recording recover" in merged.stderr
        assert not saved.exists()
        recovered = tool("recording", "recover", str(file), "--output", str(saved))
        assert recovered.returncode == 0, recovered.stderr
        assert f"{file}: " in recovered.stderr
        count = len(content(saved)) - 1
        assert 50 < count < 200 and recovered.stdout == f"{saved}: {count} messages\n"
        assert tool("recording", "check", str(saved)).returncode == 0
        saved.unlink()
    file.write_bytes(b"no recording at all")
    nothing = tool("recording", "recover", str(file), "--output", str(saved))
    assert nothing.returncode == 1 and "nothing to recover" in nothing.stderr
    assert not saved.exists()


@contextmanager
def filming(robot: rect.Robot) -> Iterator[None]:
    """Sends a video of a moving stripe, on a thread."""
    numbers = itertools.count()
    with robot.stream("camera", mode="video") as camera:

        def film() -> None:
            picture = numpy.zeros((120, 160, 3), numpy.uint8)
            picture[:, next(numbers) * 4 % 150 :][:, :10] = 250
            camera.send(picture)

        with repeating(0.05, film):
            yield


def stripes(file: Path | list[bytes]) -> list[int]:
    """Returns where the stripe is in each picture of a video, as FFmpeg decodes it."""
    if isinstance(file, Path):
        with av.open(str(file)) as container:
            pictures = list(container.decode(video=0))
    else:
        decoder = av.CodecContext.create("h264", "r")
        pictures = [picture for data in file for picture in decoder.decode(av.Packet(data))] + decoder.decode(None)
    return [int(picture.to_ndarray(format="gray")[60].argmax()) for picture in pictures]


def test_videos_are_recorded_as_viewers_show_them_and_exported(tmp_path: Path) -> None:
    endpoint, file = f"tcp/127.0.0.1:{free_port()}", tmp_path / "match.mcap"
    with rect.connect("wombat-1", listen=[endpoint]) as robot, recorder(endpoint, file) as process:
        until_recording(process)
        with filming(robot):
            time.sleep(2)
        process.terminate()
        assert process.wait(DEADLINE) == 0
    with file.open("rb") as stream:
        decoded = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["wombat-1/camera"])
        frames = [(schema and schema.name, frame.format, frame.data) for schema, _, _, frame in decoded]
    assert {frame[:2] for frame in frames} == {("foxglove.CompressedVideo", "h264")}
    positions = stripes([data for *_, data in frames])
    assert len(positions) == len(frames) > 10
    assert len(set(positions)) > 5, "the stripe moves"
    command = [program("RECT_TOOL", "rect"), "recording", "export", str(file), "--format", "pictures"]
    subprocess.run([*command, "--output", str(tmp_path / "pictures")], check=True, timeout=DEADLINE)
    assert stripes(tmp_path / "pictures" / "wombat-1-camera.mkv") == positions


def test_a_watched_video_is_saved_and_complete_whenever_the_program_is_killed(tmp_path: Path) -> None:
    endpoint, file = f"tcp/127.0.0.1:{free_port()}", tmp_path / "match.mkv"
    watch = [program("RECT_TOOL", "rect"), "stream", "watch", "wombat-1/camera", "--as", "viewer"]
    watch += ["--router", endpoint]
    with rect.connect("wombat-1", listen=[endpoint]) as robot, filming(robot):
        with subprocess.Popen([*watch, "--save", str(file)], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout
            for _ in range(20):
                assert "video/h264" in process.stdout.readline()
            process.kill()
        again = subprocess.run([*watch, "--save", str(file)], capture_output=True, text=True, timeout=DEADLINE)
    assert len(stripes(file)) >= 19
    assert again.returncode != 0
    assert "match.mkv" in again.stderr and "exists" in again.stderr
    wrong = subprocess.run([*watch, "--save", "match.mp4"], capture_output=True, text=True, timeout=DEADLINE)
    assert "choose a name that ends in .mkv" in wrong.stderr


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_killed_recorders_leave_files_that_stock_readers_open(tmp_path: Path, seed: int) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    finished = 0
    with rect.connect("wombat-1", listen=[endpoint]) as robot, publishing(robot):
        recorders = [recorder(endpoint, tmp_path / f"{number}.mcap") for number in range(KILLED)]
        processes = [running.__enter__() for running in recorders]
        for process in processes:
            until_recording(process)
        started = time.monotonic()
        # Within the first, the second and the third file of a recording.
        chosen = random.Random(seed)
        times = sorted(chosen.uniform(0.1, 12) for _ in processes)
        for process, at in zip(processes, times):
            time.sleep(max(0, started + at - time.monotonic()))
            process.kill()
        for running in recorders:
            running.__exit__(None, None, None)
    for number in range(KILLED):
        parts = tmp_path / f"{number}.segments"
        for segment in parts.glob("*.mcap"):
            finished += 1
            assert messages(segment)
        merged = tmp_path / f"{number}-merged.mcap"
        result = tool("recording", "merge", str(parts), "--output", str(merged))
        assert result.returncode == 0, result.stderr
        poses = [message for _, channel, message in messages(merged) if channel.topic == "wombat-1/pose"]
        numbers = [json.loads(pose.data)["n"] for pose in poses]
        assert numbers == list(range(min(numbers, default=0), min(numbers, default=0) + len(numbers)))
    assert finished >= KILLED / 2


def test_library_records_and_reads(tmp_path: Path) -> None:
    file = tmp_path / "match.mcap"
    with rect.connect("wombat-1", listen=[f"tcp/127.0.0.1:{free_port()}"]) as robot:
        with robot.record(file, "wombat-1/**") as recorder:
            for number in range(100):
                robot.publish("pose", {"n": number, "at": {"x": number / 2}}, urgency="urgent")
                robot.publish("angle", float(number))
            robot.publish("note", "hello")
            robot.publish("camera", rect.Payload(JPEG, "image/jpeg"))
            until_recorded(recorder, 202)
            # While it runs, the recording is a folder.
            with pytest.raises(rect.RecordingError, match="exists already"):
                robot.record(file)
        assert (recorder.recorded, recorder.dropped, recorder.problem) == (202, 0, None)
        with pytest.raises(rect.RecordingError, match="exists already"):
            robot.record(file)
    recording = rect.Recording(file)
    poses = list(recording.messages("*/pose"))
    assert [message.value["n"] for message in poses] == list(range(100))
    first = poses[0]
    assert (first.sender, first.topic, first.urgency, first.recipient) == ("wombat-1", "pose", "urgent", None)
    assert first.sequence is not None and first.sent_at is not None
    assert abs(first.recorded_at - first.sent_at) < timedelta(seconds=5)
    others = {message.topic: message for message in recording.messages("wombat-1/note", "wombat-1/camera")}
    assert others["note"].value == "hello"
    assert others["camera"].payload == rect.Payload(JPEG, "image/jpeg")
    assert len(list(recording)) == 202
    table = recording.numbers("wombat-1/pose")
    assert list(table) == ["time_s", "n", "at.x"]
    assert table["at.x"].tolist() == [number / 2 for number in range(100)]
    assert table["time_s"].tolist() == sorted(table["time_s"].tolist())
    assert recording.numbers("*/angle")["value"].tolist() == [float(number) for number in range(100)]


#: Runs a command in a folder on a disk of 32 MB, 30 MB of which are taken until the file `room` appears, and copies the
#: recording from there.
ON_A_SMALL_DISK = """
mount -t tmpfs -o size=32m none "$1" && head -c 30000000 /dev/urandom > "$1/taken"
(until [ -e "$2/room" ]; do sleep 0.1; done; rm "$1/taken") &
out=$2; cd "$1"; shift 2
"$@" & echo $! > "$out/pid"
wait $!; status=$?; cp match.mcap "$out"; exit $status
"""


def test_other_robots_and_stock_programs_get_parts_of_a_recording_of_the_library(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    fetched = tmp_path / "fetched.mcap"
    fetch = ["recording", "fetch", "wombat-1", "--as", "wombat-2", "--router", endpoint, "--output", str(fetched)]
    with rect.connect("wombat-1", listen=[endpoint]) as robot:
        with robot.record(tmp_path / "match.mcap", "wombat-1/**") as recorder:
            for number in range(300):
                robot.publish("pose", {"n": number, "padding": "x" * 500})
            robot.publish("note", "hello")
            until_recorded(recorder, 301)
            # In several parts.
            copied = tool(*fetch, "--topic", "wombat-1/pose")
            assert copied.stdout == f"{fetched}: 300 messages\n", copied.stderr
            config = zenoh.Config.from_json5(json.dumps({"mode": "client", "connect": {"endpoints": [endpoint]}}))
            with zenoh.open(config) as session:
                key = "rect/wombat-1/@rect/recording/wombat-1/note"
                (reply,) = session.get(f"{key}?_time=[now(-1m)..]")
                assert reply.ok and str(reply.ok.key_expr) == key and reply.ok.payload.to_string() == "hello"
                assert reply.ok.timestamp
                age_s = time.time() - reply.ok.timestamp.get_time().timestamp()
                assert 0 <= age_s < DEADLINE
                (refused,) = session.get(key)
                assert refused.err and "name the time" in refused.err.payload.to_string()
        after = tool(*fetch[:-1], str(tmp_path / "after.mcap"))
        assert after.returncode == 1 and "no program serves recording" in after.stderr
    numbers = [message.value["n"] for message in rect.Recording(fetched)]
    assert numbers == list(range(300))


def test_what_a_robot_sends_and_is_sent_is_recorded_once(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    default, all_of_both = tmp_path / "default.mcap", tmp_path / "all.mcap"
    with (
        rect.connect("wombat-1", listen=[endpoint]) as one,
        rect.connect("wombat-2", endpoints=[endpoint]) as two,
        one.record(default) as of_one,
        one.record(all_of_both, "wombat-1/**", "*/**") as of_both,
    ):
        one.wait_for_peer("wombat-2", timeout=DEADLINE)
        two.wait_for_peer("wombat-1", timeout=DEADLINE)
        one.wait_until_established(timeout=DEADLINE)
        two.publish("pose", 1)
        two.send("wombat-1", "drive", 2)
        one.publish("pose", 3)
        one.send("wombat-2", "grab", 4)
        until_recorded(of_one, 3)
        until_recorded(of_both, 4)

    def recorded(file: Path) -> set[tuple[str, str, str | None]]:
        messages = list(rect.Recording(file))
        found = {(message.sender, message.topic, message.recipient) for message in messages}
        assert len(found) == len(messages), "a message was recorded twice"
        return found

    own = {("wombat-1", "pose", None), ("wombat-1", "grab", "wombat-2"), ("wombat-2", "drive", "wombat-1")}
    assert recorded(default) == own
    assert recorded(all_of_both) == own | {("wombat-2", "pose", None)}


def test_lines_of_the_recorded_robots_are_recorded_unless_they_are_left_out(pair: Pair, tmp_path: Path) -> None:
    one, _ = pair

    def lines(recording: str) -> set[tuple[str, str]]:
        """Returns the robots and texts of the lines of a recording that runs."""
        reports = rect.Recording(tmp_path / f"{recording}.segments")._reports("log")
        return {(robot, value["message"]) for robot, _, value, _ in reports}

    numbers = itertools.count()

    def until_recorded_lines(text: str, level: rect.Level) -> None:
        def found() -> bool:
            for robot in pair:
                robot.log(text, level, fields={"n": next(numbers)})
            time.sleep(0.02)
            return ("wombat-1", text) in lines("own") and {("wombat-1", text), ("wombat-2", text)} <= lines("all")

        until(found)

    one.log("before")
    with (
        one.record(tmp_path / "own.mcap"),
        one.record(tmp_path / "all.mcap", "wombat-1/**", "*/**"),
        one.record(tmp_path / "none.mcap", "*/**", logs=False) as without,
    ):
        until_recorded_lines("begins", "info")
        one.log("password", "error", private=True)
        until_recorded_lines("too hot", "error")
        one.publish("pose", 1)
        until_recorded(without, 1)

    def recorded(name: str) -> list[tuple[str, bytes]]:
        read = messages(tmp_path / f"{name}.mcap")
        logs = [(channel, message) for schema, channel, message in read if schema and schema.name == "foxglove.Log"]
        return [(channel.topic, message.data) for channel, message in logs]

    of_one, of_two = "wombat-1/@rect/log", "wombat-2/@rect/log"
    assert {topic for topic, _ in recorded("own")} == {of_one}
    assert {topic for topic, _ in recorded("all")} == {of_one, of_two}
    assert recorded("none") == []
    values = [json.loads(data) for _, data in recorded("all")]
    assert {(value["message"], value["level"]) for value in values} == {("begins", 2), ("too hot", 4)}
    counted = [value["fields"]["n"] for value in values]
    assert len(set(counted)) == len(counted), "a line was recorded twice"


def test_requests_are_recorded_at_the_service(tmp_path: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with (
        rect.connect("wombat-1", listen=[endpoint]) as robot,
        rect.connect("wombat-2", router=endpoint) as asking,
        robot.record(tmp_path / "match.mcap"),
        robot.serve("sum", lambda request: sum(request.value)),
    ):
        assert asking.request("wombat-1", "sum", [1, 2]).value == 3
        with pytest.raises(rect.NoService):
            asking.request("wombat-1", "difference", "now")
    requests = list(rect.Recording(tmp_path / "match.mcap").requests())
    assert [(one.robot, one.sender, one.topic, one.value) for one in requests] == [
        ("wombat-1", "wombat-2", "sum", [1, 2]),
        ("wombat-1", "wombat-2", "difference", "now"),
    ]


def test_recording_continues_when_a_full_disk_has_room(tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    record = [program("RECT_TOOL", "rect"), "record", "wombat-1/**", "--as", "recorder", "--router", endpoint]
    command = ["unshare", "--map-root-user", "--mount", "sh", "-c", ON_A_SMALL_DISK, "sh", str(disk), str(tmp_path)]
    command += [*record, "--output", "match.mcap"]
    noise = random.Random(1)
    with (
        rect.connect("wombat-1", listen=[endpoint]) as robot,
        subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process,
    ):
        until_recording(process)
        robot.publisher("noise").wait_for_subscriber(DEADLINE)
        robot.publisher("stop", urgency="urgent").wait_for_subscriber(DEADLINE)
        # More than the disk and the 8 MB of memory hold; the recorder is given time to take it.
        for number in range(120):
            robot.publish("noise", noise.randbytes(100_000))
            robot.publish("stop", number, urgency="urgent")
            time.sleep(0.01)
        assert process.stderr
        assert any("No space left on device" in line for line in process.stderr)
        # The room that is left is used: the disk is one of that process alone.
        parts = Path(f"/proc/{(tmp_path / 'pid').read_text().strip()}/root") / disk.relative_to("/") / "match.segments"
        until(lambda: any(parts.glob("*.mcap")), lambda: list(parts.iterdir()))
        (tmp_path / "room").touch()
        assert any("is written again" in line for line in process.stderr)
        os.kill(int((tmp_path / "pid").read_text()), signal.SIGTERM)
        output, errors = process.communicate(timeout=DEADLINE)
        assert process.returncode == 0, errors
    assert " dropped" in output
    recorded = list(rect.Recording(tmp_path / "match.mcap"))
    urgent = [message.value for message in recorded if message.topic == "stop"]
    assert urgent == list(range(120))
    assert 0 < len(recorded) - len(urgent) < 120


def test_long_recording_is_split(tmp_path: Path) -> None:
    listen = [f"tcp/127.0.0.1:{free_port()}"]
    file = tmp_path / "match.mcap"
    with rect.connect("wombat-1", listen=listen) as robot, robot.record(file, split_bytes=1000) as recorder:
        # Two of them fill a segment, which is then larger than a file may be.
        for number in range(3):
            robot.publish("large", bytes(4_200_000))
            until_recorded(recorder, number + 1)
    files = sorted(tmp_path.iterdir())
    assert [file.name for file in files] == ["match-1.mcap", "match-2.mcap"]
    assert [len(list(rect.Recording(file))) for file in files] == [2, 1]


def until_recorded(recorder: rect.Recorder, count: int) -> None:
    until(lambda: recorder.recorded >= count, lambda: recorder.recorded)


def test_recording_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(rect.RecordingError, match="cannot read"):
        rect.Recording(tmp_path / "nothing.mcap")
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(b"no recording at all")
    with pytest.raises(rect.RecordingError, match="damaged"):
        list(rect.Recording(damaged))
    with pytest.raises(rect.InvalidTopicError):
        list(rect.Recording(damaged).messages("no pattern"))
    with rect.connect("wombat-1", listen=[f"tcp/127.0.0.1:{free_port()}"]) as robot:
        with pytest.raises(rect.RecordingError, match="cannot write"):
            robot.record(tmp_path / "no folder" / "match.mcap")
        with pytest.raises(rect.OptionError):
            robot.record(tmp_path / "match.mcap", keep=-1)
        with pytest.raises(rect.InvalidTopicError):
            robot.record(tmp_path / "match.mcap", "no pattern")
