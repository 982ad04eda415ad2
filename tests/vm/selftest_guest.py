"""Runs the checks of `selftest` inside the guest. Uses plain asserts and no code of RECT.

usage (in the guest): python3 selftest_guest.py pair|five|paced
"""

import hashlib
import os
import random
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent / "guest"))
import coc

SDU_BYTES = 1000


def tool(*command):
    """Runs one of the guest's tools and returns what it prints."""
    # btmgmt does nothing unless it can wait for its standard input.
    with open("/dev/ttyS0", "r+b", buffering=0) as console:
        done = subprocess.run(command, stdin=console, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, f"{' '.join(command)}: {done.stdout}{done.stderr}"
    return done.stdout


def address(adapter):
    return tool("adapter", "address", adapter).strip()


def until(what, condition, seconds=30):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"{what}: not true after {seconds} s"
        time.sleep(0.02)


def advertise(adapter):
    tool("btmgmt", "-i", adapter.removeprefix("hci"), "add-adv", "-c", "1")


@contextmanager
def channel(from_adapter, to_adapter):
    """Yields an open channel: (the dialling end, the listening end)."""
    with coc.listen(address(to_adapter)) as listener:
        dialled = coc.connect(address(from_adapter), address(to_adapter))
        with dialled, coc.accept(listener) as accepted:
            yield dialled, accepted


def transfer(sender, receiver, sdus, seed):
    """Sends `sdus` SDUs of random bytes, checks that they arrive unchanged, and returns the rate in bytes/s."""
    data = random.Random(seed).randbytes(sdus * SDU_BYTES)
    failure = []

    def send():
        try:
            for start in range(0, len(data), SDU_BYTES):
                sender.send(data[start : start + SDU_BYTES])
        except OSError as e:
            failure.append(e)

    thread = threading.Thread(target=send)
    thread.start()
    received, arrivals = hashlib.md5(), []
    for _ in range(sdus):
        received.update(receiver.recv(65535))
        arrivals.append(time.monotonic())
    thread.join()
    assert not failure, failure
    assert received.hexdigest() == hashlib.md5(data).hexdigest(), "the received data differs from the sent data"
    return (sdus - 1) * SDU_BYTES / max(arrivals[-1] - arrivals[0], 1e-9)


def end_reason(sock):
    """Returns how a channel ended, as the kernel reports it to a reader."""
    try:
        return "closed" if sock.recv(65535) == b"" else "data"
    except OSError as e:
        return os.strerror(e.errno)


def pair():
    assert tool("adapter", "list").split() == ["hci0", "hci1"]
    advertise("hci1")
    found = tool("btmgmt", "-i", "0", "--timeout", "20", "find", "-l")
    assert f"dev_found: {address('hci1')}" in found, found
    print("discovery by btmgmt: ok")

    with channel("hci0", "hci1") as (a, b):
        print(f"transfer hci0 to hci1: {transfer(a, b, 200, 1) / 1000:.0f} kB/s")
        print(f"transfer hci1 to hci0: {transfer(b, a, 200, 2) / 1000:.0f} kB/s")
        tool("room", "freeze", "hci0")
        a.send(b"late")
        b.settimeout(0)
        with suppress(BlockingIOError):
            assert not b.recv(100), "received data of a frozen controller"
        b.settimeout(30)
        tool("room", "thaw", "hci0")
        assert b.recv(100) == b"late"
        print("freeze and thaw: ok")
        assert tool("room", "drop", "hci0").strip() == "1 links dropped"
        reasons = {end_reason(a), end_reason(b)}
        assert reasons == {"Connection timed out"}, reasons
        print("drop: both ends report a supervision timeout")

    tool("adapter", "power", "hci1", "off")
    tool("adapter", "power", "hci1", "on")
    tool("bluetoothd", "kill")
    tool("bluetoothd", "start")
    tool("adapter", "wait", "hci0")
    tool("adapter", "wait", "hci1")
    print("adapter off and on, bluetoothd killed and started: ok")

    added = tool("room", "add").strip()
    tool("adapter", "wait", added)
    tool("room", "remove", added)
    until(f"{added} is removed", lambda: added not in tool("adapter", "list"))
    print("controller added and removed: ok")


def five():
    robots = [f"hci{n}" for n in range(5)]
    assert tool("adapter", "list").split() == robots
    hub, *others = robots
    for robot in others:
        advertise(robot)
    listeners = [coc.listen(address(robot)) for robot in others]
    links = [coc.connect(address(hub), address(robot)) for robot in others]
    far_ends = [coc.accept(listener) for listener in listeners]
    for n, (near, far) in enumerate(zip(links, far_ends, strict=True)):
        transfer(near, far, 20, n)
        transfer(far, near, 20, 10 + n)
    print("five controllers, one hub with four links, each carries separate data: ok")


def paced():
    pace = int(os.environ["RECT_VM_PACE"])
    advertise("hci1")
    best = 0.0
    # The rate must never exceed the limit. How close it gets depends on the machine's load, so the best of three
    # attempts counts.
    for attempt in range(3):
        with channel("hci0", "hci1") as (a, b):
            rate = transfer(a, b, 100, attempt)
        print(f"limited to {pace / 1000:.0f} kB/s: measured {rate / 1000:.1f} kB/s")
        assert rate <= 1.05 * pace, "faster than the limit"
        best = max(best, rate)
        if best >= 0.9 * pace:
            return
    raise AssertionError(f"the best of three attempts reaches {best / pace:.0%} of the limit")


if __name__ == "__main__":
    print(f"booted in {os.environ['RECT_VM_UPTIME']} s, kernel {os.uname().release}")
    {"pair": pair, "five": five, "paced": paced}[sys.argv[1]]()
