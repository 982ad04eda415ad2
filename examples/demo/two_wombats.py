"""Two simulated KIPR Wombats talk over Bluetooth Low Energy: `make demo`.

Every program here is an unmodified eclipse-zenoh client; only the routers know about Bluetooth. Exit status 0 means
that every message that had to arrive did, intact.
"""

import hashlib
import importlib.metadata
import io
import json
import shutil
import sys
import time

import zenoh
from PIL import Image
from robots import Inbox, Robot, RobotError
from room import Room, wait_for_link, wait_for_no_link

CONDITION = "room"
# A Pi 3B's radio knows no long packets: `--pdu 27` is its pace.
MESSAGES = 20
PHOTOGRAPHS = ["astronaut.png", "coffee.png", "chelsea.png", "rocket.jpg", "camera.png", "motorcycle_left.png"]
WAIT_S = 20
NEXT = """
Now try it yourself. Two simulated robots, in one terminal:

  {rect} sim

and in another one:

  {rect} peers                     # which robots are there
  {rect} sub '*/**'                # everything that they publish
  {rect} topic list                # which topics there are
  {rect} request wombat-2 battery  # asks a service

{rect} --help has the rest; docs/python.md shows how to write a program, docs/install.md how to install a robot."""


def main() -> int:
    started = time.monotonic()
    print(f"Two Wombats in a simulated {CONDITION}: one router each, linked by Bluetooth Low Energy (L2CAP).\n")
    with Room(CONDITION, "--pdu", "27") as room:
        one, two = room.add_robot("wombat-1"), room.add_robot("wombat-2")
        link_s = wait_for_link(one, two)
        say("link", f"wombat-1 and wombat-2 found each other by name and linked in {link_s:.1f} s")
        with one.session() as here, two.session() as there:
            json_both_ways(here, there)
            question_and_answer(here, there)
            photographs(here, there)
            radio_cut(room, one, two, here, there)
        adapters = room.status()["adapters"]
    for adapter in adapters:
        print(
            f"  {adapter['name']} sent {adapter['stats']['bytes_on_air'] / 1000:.0f} kB, headers and repeats included"
        )
    print(f"Everything arrived, intact, in {time.monotonic() - started:.0f} s.")
    print(NEXT.format(rect=shutil.which("rect") or "rect"))
    return 0


def json_both_ways(here: zenoh.Session, there: zenoh.Session) -> None:
    """JSON from a program on each robot to a subscriber on the other."""
    for sender, receiver, name in ((here, there, "wombat-1"), (there, here, "wombat-2")):
        key = f"rect/{name}/arm/angle"
        inbox = Inbox(receiver, key, sender)
        for n in range(MESSAGES):
            value = json.dumps({"n": n, "degrees": n * 4.5, "at": time.time()})
            sender.put(key, value, encoding=zenoh.Encoding.APPLICATION_JSON)
        received = [json.loads(payload) for payload in inbox.take(MESSAGES)]
        expect([m["n"] for m in received] == list(range(MESSAGES)), f"{key} arrives whole and in order")
        last_ms = (time.time() - received[-1]["at"]) * 1000
        say(
            "put",
            f"{MESSAGES} JSON messages on {key}: all arrived, in order (the last one took about {last_ms:.0f} ms)",
        )
        inbox.close()


def question_and_answer(here: zenoh.Session, there: zenoh.Session) -> None:
    """A request to a service of the other robot."""
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
    say("get", f"wombat-1 asked {key}: {replies[0]} in {(time.monotonic() - asked) * 1000:.0f} ms")
    service.undeclare()


def photographs(here: zenoh.Session, there: zenoh.Session) -> None:
    """A stream of real photographs, as a camera would send them."""
    key = "rect/wombat-1/camera"
    frames = [camera_frame(name) for name in PHOTOGRAPHS]
    inbox = Inbox(there, key, here)
    started = time.monotonic()
    for frame in frames:
        # Zenoh's default gives a large message up on a slow link; a camera on Bluetooth waits for it instead.
        here.put(
            key,
            frame,
            encoding=zenoh.Encoding.IMAGE_JPEG,
            priority=zenoh.Priority.DATA_LOW,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
    received = inbox.take(len(frames))
    took = time.monotonic() - started
    expect([digest(f) for f in received] == [digest(f) for f in frames], "photographs arrive intact")
    size_kb = sum(map(len, frames)) / 1000
    say("stream", f"{len(frames)} photographs, {size_kb:.0f} kB in {took:.1f} s: {size_kb / took:.0f} kB/s, all intact")
    inbox.close()


def radio_cut(room: Room, one: Robot, two: Robot, here: zenoh.Session, there: zenoh.Session) -> None:
    """The radio goes away and comes back; nobody does anything about it."""
    key = "rect/wombat-1/arm/angle"
    inbox = Inbox(there, key, here)
    room.cut()
    gone_s = wait_for_no_link(one, two)
    say("cut", f"the radio is gone: both routers noticed after {gone_s:.1f} s")
    room.restore()
    back_s = wait_for_link(one, two)
    inbox.wait_until_reached(here)
    for n in range(MESSAGES):
        here.put(key, json.dumps({"n": n}), encoding=zenoh.Encoding.APPLICATION_JSON)
    received = [json.loads(payload)["n"] for payload in inbox.take(MESSAGES)]
    expect(received == list(range(MESSAGES)), "messages arrive after the cut")
    say("back", f"the radio is back: linked again by itself after {back_s:.1f} s, {MESSAGES} messages arrived")
    inbox.close()


def camera_frame(name: str) -> bytes:
    """A photograph as a robot's camera would send it over a slow radio."""
    # The package is here for its photographs only; importing it would need all that it depends on.
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
        raise RobotError(f"not so: {what}")


def say(step: str, text: str) -> None:
    print(f"  {step:<7} {text}", flush=True)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except RobotError as error:
        print(f"\nThe demo failed: {error}", file=sys.stderr)
        sys.exit(1)
