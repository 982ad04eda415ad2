"""Shows two simulated KIPR Wombats that exchange messages over Bluetooth Low Energy: `make demo`.

All programs are unmodified eclipse-zenoh clients; only the routers use Bluetooth. Exit status 0 means that all messages
arrived intact.
"""

import hashlib
import importlib.metadata
import io
import json
import os
import shutil
import sys
import time

import zenoh
from PIL import Image
from robots import AnyRobot, Collector, Robot, RobotError, wait_until
from room import Room, wait_for_link, wait_for_no_link

CONDITION = "room"
MESSAGES = 20
PHOTOGRAPHS = ["astronaut.png", "coffee.png", "chelsea.png", "rocket.jpg", "camera.png", "motorcycle_left.png"]
WAIT_S = 20
NEXT = """
Now try it yourself. Start two simulated robots in one terminal:

  {rect} sim

and use another one for these commands:

  {rect} peers                     # lists the robots that are reachable
  {rect} sub '*/**'                # prints everything that they publish
  {rect} topic list                # lists the topics
  {rect} request wombat-2 battery  # sends a request to a service

{rect} --help lists all commands. docs/reference/python.md shows how to write a program, and
docs/how-to/wombat.md how to install RECT on a robot."""


def main() -> int:
    started = time.monotonic()
    print(f"Two Wombats in a simulated {CONDITION}: one router each, linked by Bluetooth Low Energy (L2CAP).\n")
    # The radio of a Pi 3B does not support long packets: `--pdu 27` gives its rate.
    with Room(CONDITION, "--pdu", "27") as room:
        one, two = room.add_robot("wombat-1"), room.add_robot("wombat-2")
        link_s = wait_for_link(one, two)
        report("link", f"wombat-1 and wombat-2 discovered each other by name and were linked within {link_s:.1f} s")
        with one.session() as here, two.session() as there:
            json_both_ways(here, there)
            question_and_answer(here, there)
            photographs(here, there)
            radio_cut(room, one, two, here, there)
        adapters = room.status()["adapters"]
    wifi_is_jammed()
    for adapter in adapters:
        print(
            f"  {adapter['name']} sent {adapter['stats']['bytes_on_air'] / 1000:.0f} kB, with headers and repetitions"
        )
    print(f"All messages arrived intact, in {time.monotonic() - started:.0f} s.")
    print(NEXT.format(rect=tool()))
    return 0


def tool() -> str:
    """Returns how the user runs `rect` from this folder: `make demo` has it in its PATH, and the user may not."""
    path = shutil.which("rect")
    if path is None:
        return "rect"
    relative = os.path.relpath(path)
    return path if relative.startswith("..") else relative


def json_both_ways(here: zenoh.Session, there: zenoh.Session) -> None:
    """Publishes JSON from a program on each robot to a subscriber on the other."""
    for sender, receiver, name in ((here, there, "wombat-1"), (there, here, "wombat-2")):
        key = f"rect/{name}/arm/angle"
        collector = Collector(receiver, key, sender)
        for n in range(MESSAGES):
            value = json.dumps({"n": n, "degrees": n * 4.5, "at": time.time()})
            sender.put(key, value, encoding=zenoh.Encoding.APPLICATION_JSON)
        received = [json.loads(payload) for payload in collector.take(MESSAGES)]
        expect([m["n"] for m in received] == list(range(MESSAGES)), f"{key} arrives completely and in order")
        last_ms = (time.time() - received[-1]["at"]) * 1000
        report(
            "put",
            f"{MESSAGES} JSON messages on {key}: all arrived, in order (the last one took about {last_ms:.0f} ms)",
        )
        collector.close()


def question_and_answer(here: zenoh.Session, there: zenoh.Session) -> None:
    """Sends a request to a service of the other robot."""
    key = "rect/wombat-2/battery"
    answer = {"volts": 12.4, "percent": 83}

    def serve(query: zenoh.Query) -> None:
        query.reply(key, json.dumps(answer), encoding=zenoh.Encoding.APPLICATION_JSON)

    service = there.declare_queryable(key, serve)
    deadline = time.monotonic() + WAIT_S
    replies: list[dict] = []
    while not replies and time.monotonic() < deadline:
        asked = time.monotonic()
        replies = [json.loads(r.ok.payload.to_bytes()) for r in here.get(key, timeout=2) if r.ok is not None]
    expect(replies == [answer], f"{key} answers")
    report("get", f"wombat-1 requested {key}: {replies[0]} in {(time.monotonic() - asked) * 1000:.0f} ms")
    service.undeclare()


def photographs(here: zenoh.Session, there: zenoh.Session) -> None:
    """Sends real photographs, as a camera would."""
    key = "rect/wombat-1/camera"
    frames = [camera_frame(name) for name in PHOTOGRAPHS]
    collector = Collector(there, key, here)
    started = time.monotonic()
    for frame in frames:
        # By default Zenoh drops a large message on a slow link; a camera on Bluetooth waits instead.
        here.put(
            key,
            frame,
            encoding=zenoh.Encoding.IMAGE_JPEG,
            priority=zenoh.Priority.DATA_LOW,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
    received = collector.take(len(frames))
    took = time.monotonic() - started
    expect([digest(f) for f in received] == [digest(f) for f in frames], "photographs arrive intact")
    size_kb = sum(map(len, frames)) / 1000
    report("stream", f"{len(frames)} photographs, {size_kb:.0f} kB in {took:.1f} s: {size_kb / took:.0f} kB/s")
    collector.close()


def radio_cut(room: Room, one: Robot, two: Robot, here: zenoh.Session, there: zenoh.Session) -> None:
    """Interrupts the radio; the robots link again without any help."""
    key = "rect/wombat-1/arm/angle"
    collector = Collector(there, key, here)
    room.cut()
    noticed_s = wait_for_no_link(one, two)
    report("cut", f"the radio is interrupted: both routers noticed after {noticed_s:.1f} s")
    room.restore()
    back_s = wait_for_link(one, two)
    collector.wait_until_reached(here)
    for n in range(MESSAGES):
        here.put(key, json.dumps({"n": n}), encoding=zenoh.Encoding.APPLICATION_JSON)
    received = [json.loads(payload)["n"] for payload in collector.take(MESSAGES)]
    expect(received == list(range(MESSAGES)), "messages arrive after the cut")
    report("back", f"the radio is back: linked again automatically after {back_s:.1f} s, {MESSAGES} messages arrived")
    collector.close()


def wifi_is_jammed() -> None:
    """Links two robots by Bluetooth and Wi-Fi, and jams the Wi-Fi in the middle of a transmission."""
    print("\nTwo Wombats that share a Wi-Fi, too: one link, which uses both.\n")
    with Room(CONDITION, "--pdu", "27", has_wifi=True) as room:
        one, two = room.add_robot("wombat-1", kind=AnyRobot), room.add_robot("wombat-2", kind=AnyRobot)
        wait_until("the robots are linked by both", 20, lambda: one.bulk_path() == "tcp" and one.has_path("ble"))
        report("link", "the two met over Bluetooth, and moved the load to the Wi-Fi by themselves")
        with one.session() as here, two.session() as there:
            photographs(here, there)
            stop_commands(room, here, there)
            photographs(here, there)
            room.set_wifi("on")
            back_s = wait_until("the load is on the Wi-Fi", 20, lambda: one.bulk_path() == "tcp")
            report("back", f"the Wi-Fi works again: it carries the load after {back_s:.1f} s")
            photographs(here, there)


def stop_commands(room: Room, here: zenoh.Session, there: zenoh.Session) -> None:
    """Jams the Wi-Fi while urgent messages are sent."""
    key = "rect/wombat-1/stop"
    arrived: list[tuple[int, float]] = []
    collector = Collector(there, key, here)
    subscriber = there.declare_subscriber(key, lambda sample: arrived.append(age_ms(sample)))
    room.set_wifi("silent")
    for n in range(MESSAGES):
        command = json.dumps({"n": n, "at": time.time()})
        here.put(
            key,
            command,
            priority=zenoh.Priority.REAL_TIME,
            congestion_control=zenoh.CongestionControl.BLOCK,
            express=True,
        )
        time.sleep(0.05)
    received = [json.loads(payload)["n"] for payload in collector.take(MESSAGES)]
    expect(received == list(range(MESSAGES)), "each stop command arrives once, in order")
    latest_ms = max(age for _, age in arrived)
    report(
        "jam", f"the Wi-Fi is jammed: {MESSAGES} stop commands arrived over Bluetooth, each within {latest_ms:.0f} ms"
    )
    collector.close()
    subscriber.undeclare()


def age_ms(sample: zenoh.Sample) -> tuple[int, float]:
    """Returns the number of a stop command, and its age in milliseconds."""
    command = json.loads(sample.payload.to_bytes())
    return command["n"], (time.time() - command["at"]) * 1000


def camera_frame(name: str) -> bytes:
    """Returns a photograph as a robot's camera would send it over a slow radio."""
    # Only the photographs of the package are used; importing it would require its dependencies.
    data = importlib.metadata.distribution("scikit-image").locate_file("skimage/data")
    picture = Image.open(data / name).convert("RGB")
    picture.thumbnail((320, 240))
    jpeg = io.BytesIO()
    picture.save(jpeg, "JPEG", quality=70)
    return jpeg.getvalue()


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def expect(holds: bool, what: str) -> None:
    if not holds:
        raise RobotError(f"this check failed: {what}")


def report(step: str, text: str) -> None:
    print(f"  {step:<7} {text}", flush=True)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except RobotError as error:
        print(f"\nThe demo failed: {error}", file=sys.stderr)
        sys.exit(1)
