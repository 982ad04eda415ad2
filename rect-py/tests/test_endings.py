"""Programs end at once, whatever they were doing and in whichever order they let go; forks and Ctrl-C are defined.

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
# Whoever runs the tests may be in the background, where Ctrl-C is ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
endpoint = "tcp/127.0.0.1:{port}"
one = rect.connect("wombat-1", listen=[endpoint])
two = rect.connect("wombat-2", endpoints=[endpoint])
with two.on_state() as events:
    while events.next(20).what != "peer_up":
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
        "one.close(); heard = one.zenoh",
        "heard = two.subscribe('*/x'); del two",
        "heard = two.subscribe('*/x', print); one.close()",
        "heard = two.subscribe('*/**', lambda message: time.sleep(60)); [one.publish('x', n) for n in range(100)]",
        "heard = two.subscribe('*/**', capacity=1, when_full='wait'); [one.publish('x', n) for n in range(100)]",
        "service = one.serve('slow', lambda request: time.sleep(60)); "
        "threading.Thread(target=lambda: two.request('wombat-1', 'slow', timeout=60), daemon=True).start(); "
        "time.sleep(0.2)",
        "replies = two.request_all('nothing', timeout=60)",
        "stream = one.stream('camera'); watch = two.watch('wombat-1', 'camera'); del one, two",
        "maps = two.receive_transfers('*/maps'); one.transfer('wombat-2', 'maps', b'x' * 1_000_000)",
        "threading.Thread(target=lambda: one.transfer('nobody', 'maps', b''), daemon=True).start()",
        "threading.Thread(target=lambda: list(two.subscribe('*/x')), daemon=True).start()",
        "two.on_state(print)",
        "sys.exit(0)",
        "circle = [one]; circle.append(circle); del one",
        "threading.Thread(target=lambda: [one.publish('x', n) for n in range(10**7)], daemon=True).start()",
    ],
)
def test_a_program_ends_at_once_in_any_order(ending: str) -> None:
    ended = run(ending)
    assert ended.returncode == 0, ended.stderr
    # Threads that were at work may say that the session is closed; nothing worse.
    assert "Fatal" not in ended.stderr and "panicked" not in ended.stderr, ended.stderr


def test_an_error_that_ends_a_program_ends_it() -> None:
    ended = run("raise ValueError('on purpose')")
    assert ended.returncode == 1
    assert ended.stderr.strip().endswith("ValueError: on purpose")


@pytest.mark.parametrize(
    "waiting",
    [
        "two.subscribe('*/x').next()",
        "list(two.subscribe('*/x'))",
        "two.listen('wombat-1', 'x', 60)",
        "one.serve('slow', lambda request: threading.Event().wait()); "
        "time.sleep(0.3); two.request('wombat-1', 'slow', timeout=60)",
        "one.transfer('nobody', 'maps', b'')",
        "two.receive_transfers('*/maps').next()",
        "two.watch('wombat-1', 'camera').next()",
        "events = two.on_state(); events.next(); list(events)",
        "rect.connect('wombat-3', router='tcp/127.0.0.1:9', timeout=60)",
        "import asyncio, rect.aio; asyncio.run(rect.aio.Robot(two).subscribe('*/x').next())",
    ],
)
def test_ctrl_c_ends_every_wait_at_once(waiting: str) -> None:
    command = [sys.executable, "-c", program(f"print('waits', flush=True)\n{waiting}")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "waits\n"
            # Python may not wait yet; whatever it does then, Ctrl-C ends it.
            # (But for a finaliser: Python drops what is raised there.)
            process.send_signal(signal.SIGINT)
            _, error = process.communicate(timeout=10)
        finally:
            process.kill()
    assert "KeyboardInterrupt" in error


_CAMERA = """
    import numpy
    camera = one.stream("camera")
    watch = two.watch("wombat-1", "camera")
    picture = numpy.random.default_rng(1).integers(0, 256, (480, 640, 3), numpy.uint8)
    def film():
        while not one.is_closed:
            camera.send(picture)
    threading.Thread(target=film, daemon=True).start()
    watch.next(timeout=20)
"""


@pytest.mark.parametrize("ending", ["one.close(); two.close()", "pass"])
def test_a_camera_program_ends_without_a_traceback(ending: str) -> None:
    ended = run(_CAMERA + f"    {ending}\n")
    assert (ended.returncode, ended.stderr) == (0, "")


def test_ctrl_c_in_a_camera_program_is_the_only_traceback() -> None:
    code = program(_CAMERA + "    print('films', flush=True)\n    time.sleep(60)\n")
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "films\n"
            process.send_signal(signal.SIGINT)
            _, error = process.communicate(timeout=10)
        finally:
            process.kill()
    assert error.count("Traceback") == 1 and error.strip().endswith("KeyboardInterrupt"), error


def test_a_robot_of_the_parent_says_so_in_a_child_which_ends() -> None:
    ended = run(
        """
        heard = two.subscribe("*/x")
        child = os.fork()
        if child == 0:
            calls = [lambda: one.publish("x", 1), lambda: heard.next(1), lambda: two.subscribe("*/x"), two.peers]
            calls += [lambda: rect.connect("wombat-3", endpoints=[endpoint])]
            for call in calls:
                try:
                    call()
                except rect.Closed as error:
                    assert "fork before rect.connect" in str(error), error
                else:
                    raise AssertionError("it was not refused")
            one.close()
            sys.exit(7)
        _, status = os.waitpid(child, 0)
        assert os.waitstatus_to_exitcode(status) == 7, status
        assert two.peers() == ["wombat-1"]
        """
    )
    assert ended.returncode == 0, ended.stderr


def test_a_child_that_was_forked_before_may_join() -> None:
    port = free_port()
    code = f"""
import os, sys, rect
child = os.fork()
name = "wombat-1" if child else "wombat-2"
given = {{"listen" if child else "endpoints": ["tcp/127.0.0.1:{port}"]}}
with rect.connect(name, **given) as robot:
    while not child and robot.peers() != ["wombat-1"]:
        pass
    if child:
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
"""
    subprocess.run([sys.executable, "-c", code], timeout=DEADLINE, check=True)


def test_multiprocessing_by_fork_and_by_spawn_ends() -> None:
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


def test_it_is_imported_quickly_and_without_numpy_or_pillow() -> None:
    code = "import sys, rect; print([name for name in ('numpy', 'PIL') if name in sys.modules])"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout.strip() == "[]"
