"""Tests that programs exit at once in every state and closing order, and the behaviour after a fork and on Ctrl-C.

pytest rect-py/tests/test_endings.py
"""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap

import pytest
from conftest import DEADLINE, free_port

_BEGINNING = """
import os, signal, sys, threading, time
import rect
# The tests may run in the background, where SIGINT is ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
endpoint = "tcp/127.0.0.1:{port}"
one = rect.connect("wombat-1", listen=[endpoint])
two = rect.connect("wombat-2", endpoints=[endpoint])
with two.events() as events:
    while events.next(20).kind != "peer_up":
        pass
"""


def program(ending: str) -> str:
    return _BEGINNING.format(port=free_port()) + textwrap.dedent(ending)


def run(ending: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program(ending)], capture_output=True, text=True, timeout=DEADLINE, check=False
    )


@pytest.mark.parametrize(
    "ending",
    [
        "pass",
        "del one, two",
        "two.close(); one.close()",
        "one.zenoh.close(); two.zenoh.close()",
        "one.close(); subscriber = one.zenoh",
        "subscriber = two.subscribe('*/x'); del two",
        "subscriber = two.subscribe('*/x', callback=print); one.close()",
        "subscriber = two.subscribe('*/**', callback=lambda _: time.sleep(60)); one.publish('x', 1)",
        "subscriber = two.subscribe('*/**', capacity=1, when_full='block'); [one.publish('x', n) for n in range(100)]",
        "service = one.serve('slow', lambda request: time.sleep(60)); "
        "threading.Thread(target=lambda: two.request('wombat-1', 'slow', timeout=60), daemon=True).start(); "
        "time.sleep(0.2)",
        "replies = two.request_all('nothing', timeout=60)",
        "stream = one.stream('camera'); watch = two.watch('wombat-1/camera'); del one, two",
        "maps = two.receive_transfers('*/maps'); one.transfer('wombat-2', 'maps', b'x' * 1_000_000)",
        "threading.Thread(target=lambda: one.transfer('nobody', 'maps', b''), daemon=True).start()",
        "threading.Thread(target=lambda: list(two.subscribe('*/x')), daemon=True).start()",
        # Some of these threads are inside Zenoh when the program ends.
        "peers = lambda: [two.peers() for _ in range(10**7)]; "
        "[threading.Thread(target=peers, daemon=True).start() for _ in range(8)]; "
        "time.sleep(0.1)",
        "two.on_event(print)",
        "sys.exit(0)",
        "circle = [one]; circle.append(circle); del one",
        "threading.Thread(target=lambda: [one.publish('x', n) for n in range(10**7)], daemon=True).start()",
    ],
)
def test_program_exits_at_once_in_any_closing_order(ending: str) -> None:
    ended = run(ending)
    assert ended.returncode == 0, ended.stderr
    # Running threads may report that the session is closed, but nothing worse.
    assert "Fatal" not in ended.stderr and "panicked" not in ended.stderr, ended.stderr


def test_program_exits_with_uncaught_exception() -> None:
    ended = run("raise ValueError('on purpose')")
    assert ended.returncode == 1
    assert ended.stderr.strip().endswith("ValueError: on purpose")


@pytest.mark.parametrize(
    "waiting",
    [
        "two.subscribe('*/x').next()",
        "list(two.subscribe('*/x'))",
        "two.wait_for_message('wombat-1/x', timeout=60)",
        "one.serve('slow', lambda request: threading.Event().wait()); "
        "time.sleep(0.3); two.request('wombat-1', 'slow', timeout=60)",
        "one.transfer('nobody', 'maps', b'')",
        "two.receive_transfers('*/maps').next()",
        "two.watch('wombat-1/camera').next()",
        "events = two.events(); events.next(); list(events)",
        "rect.connect('wombat-3', router='tcp/127.0.0.1:9', timeout=60)",
        "import asyncio, rect.aio; asyncio.run(rect.aio.Robot(two).subscribe('*/x').next())",
    ],
)
def test_ctrl_c_interrupts_every_wait(waiting: str) -> None:
    command = [sys.executable, "-c", program(f"print('waiting', flush=True)\n{waiting}")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "waiting\n"
            # Ctrl-C must also work if the wait has not begun yet, unless Python is running a finaliser: an exception
            # that is raised there is lost.
            process.send_signal(signal.SIGINT)
            _, error = process.communicate(timeout=10)
        finally:
            process.kill()
    assert "KeyboardInterrupt" in error


_CAMERA = """
    import numpy
    camera = one.stream("camera")
    watch = two.watch("wombat-1/camera")
    picture = numpy.random.default_rng(1).integers(0, 256, (480, 640, 3), numpy.uint8)
    def send_frames():
        try:
            while True:
                camera.send(picture)
        except rect.Closed:
            pass
    threading.Thread(target=send_frames, daemon=True).start()
    watch.next(timeout=20)
"""


@pytest.mark.parametrize("ending", ["one.close(); two.close()", "pass"])
def test_camera_program_exits_without_traceback(ending: str) -> None:
    ended = run(_CAMERA + f"    {ending}\n")
    assert (ended.returncode, ended.stderr) == (0, "")


def test_ctrl_c_in_camera_program_prints_one_traceback() -> None:
    code = program(_CAMERA + "    print('sending', flush=True)\n    time.sleep(60)\n")
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "sending\n"
            process.send_signal(signal.SIGINT)
            _, error = process.communicate(timeout=10)
        finally:
            process.kill()
    assert error.count("Traceback") == 1 and error.strip().endswith("KeyboardInterrupt"), error


def test_robot_of_parent_raises_closed_in_forked_child() -> None:
    ended = run(
        """
        subscriber = two.subscribe("*/x")
        child = os.fork()
        if child == 0:
            calls = [lambda: one.publish("x", 1), lambda: subscriber.next(1), lambda: two.subscribe("*/x"), two.peers]
            calls += [lambda: rect.connect("wombat-3", endpoints=[endpoint])]
            for call in calls:
                try:
                    call()
                except rect.Closed as error:
                    assert "fork before rect.connect" in str(error), error
                else:
                    raise AssertionError("Closed was not raised")
            one.close()
            sys.exit(7)
        _, status = os.waitpid(child, 0)
        assert os.waitstatus_to_exitcode(status) == 7, status
        assert two.peers() == ["wombat-1"]
        """
    )
    assert ended.returncode == 0, ended.stderr


def test_child_forked_before_connect_can_connect() -> None:
    port = free_port()
    code = f"""
import os, sys, rect
child = os.fork()
name = "wombat-1" if child else "wombat-2"
given = {{"listen" if child else "endpoints": ["tcp/127.0.0.1:{port}"]}}
with rect.connect(name, **given) as robot:
    if not child:
        robot.wait_for_peer("wombat-1", timeout={DEADLINE})
    else:
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
"""
    subprocess.run([sys.executable, "-c", code], timeout=DEADLINE, check=True)


def test_multiprocessing_with_fork_and_spawn_exits() -> None:
    ended = run(
        """
        import multiprocessing
        for method in ("fork", "spawn"):
            worker = multiprocessing.get_context(method).Process(target=print, args=("done",))
            worker.start()
            worker.join(20)
            assert worker.exitcode == 0, method
        """
    )
    assert ended.returncode == 0, ended.stderr


def test_import_does_not_load_numpy_or_pillow() -> None:
    code = "import sys, rect; print([name for name in ('numpy', 'PIL') if name in sys.modules])"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout.strip() == "[]"
