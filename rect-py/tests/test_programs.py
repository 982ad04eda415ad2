"""Tests the programs of robots: their names, the catalogue of their services, and events when they begin and end. Two
routers are linked on the simulated air.

RECT_ROUTER=target/checked/rect-router RECT_TOOL=target/checked/rect pytest rect-py/tests/test_programs.py
"""

from __future__ import annotations

import asyncio
import logging
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Optional

import pytest
import rect
import rect.aio
from conftest import DEADLINE, free_port, until, until_served
from programs import Routers
from rect import _rect

#: The upper limit of the delay of an event, in seconds. Events are faster by far, unless the computer is busy.
AT_ONCE = 5.0

#: The programs of a robot with the topics of their services, in the order of the catalogue.
Catalogue = list[tuple[Optional[str], list[str]]]


def catalogue(robot: rect.Robot, of: str | None = None) -> Catalogue:
    """Returns what a robot sees in the catalogue of another one, or in its own."""
    return [(program.name, [service.topic for service in program.services]) for program in robot.programs(of)]


def until_catalogue(robot: rect.Robot, expected: Catalogue, of: str | None = None) -> None:
    """Waits until a robot sees these programs and services. The router may not have been discovered yet."""

    def is_seen() -> bool:
        try:
            return catalogue(robot, of) == expected
        except (rect.NoService, rect.TimedOut):
            return False

    until(is_seen, lambda: catalogue(robot, of))


@contextmanager
def program_events(robot: rect.Robot) -> Iterator[Callable[[str, str], float]]:
    """Yields a function that waits for an event of this kind about a program, and returns the time of its arrival."""
    seen: queue.SimpleQueue[tuple[float, rect.Event]] = queue.SimpleQueue()

    def arrival(kind: str, program: str) -> float:
        while True:
            at, event = seen.get(timeout=DEADLINE)
            if event.program == program:
                assert (event.kind, event.robot) == (kind, "wombat-1")
                return at

    with robot.on_event(lambda event: seen.put((time.monotonic(), event))):
        yield arrival


@contextmanager
def script(folder: Path, name: str, code: str) -> Iterator[subprocess.Popen[str]]:
    """Runs a program in a file of this name. Its standard input remains open."""
    file = folder / name
    file.write_text(f"import sys, time, rect\n{code}")
    with subprocess.Popen(
        [sys.executable, str(file)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def stop(process: subprocess.Popen[str]) -> None:
    """Stops a program, and waits until each of its threads is stopped: some may still run for a moment."""
    process.send_signal(signal.SIGSTOP)
    threads = Path(f"/proc/{process.pid}/task")
    # The state is the first field after the name in parentheses.
    until(lambda: all((task / "stat").read_text().rpartition(")")[2].split()[0] == "T" for task in threads.iterdir()))


def line_of(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def test_catalogue_lists_programs_with_services_and_descriptions(routers: Routers) -> None:
    with (
        routers.connect("wombat-1", "arm") as arm,
        routers.connect("wombat-1", "drive") as drive,
        routers.connect("wombat-2") as other,
    ):
        until_catalogue(drive, [("arm", []), ("drive", [])])

        @arm.serve("look", allow_several=True)
        def look(request: rect.Request) -> None:
            """Returns what the camera sees.

            As a picture.
            """

        arm.serve("grab", lambda request: "done", about="closes the gripper")
        drive.serve("stop", lambda request: "done")
        for robot in (drive, other):
            until_catalogue(robot, [("arm", ["grab", "look"]), ("drive", ["stop"])], "wombat-1")
            programs = robot.programs("wombat-1")
            assert [program.name for program in programs] == ["arm", "drive"]
            assert programs[0].services == (
                rect.ServiceEntry("grab", "closes the gripper", several=False),
                rect.ServiceEntry("look", "Returns what the camera sees.", several=True),
            )
            assert programs[1].services == (rect.ServiceEntry("stop", "", several=False),)
            assert all(len(program.instance) == 8 for program in programs)
        assert other.programs() == []


def test_ended_services_and_programs_leave_catalogue(routers: Routers) -> None:
    with routers.connect("wombat-1", "drive") as drive, routers.connect("wombat-2") as other:
        with routers.connect("wombat-1", "arm") as arm:
            grab = arm.serve("grab", lambda request: "done")
            arm.serve("look", lambda request: "done")
            until_catalogue(other, [("drive", []), ("arm", ["grab", "look"])], "wombat-1")
            grab.close()
            until_catalogue(other, [("drive", []), ("arm", ["look"])], "wombat-1")
        for robot in (drive, other):
            until_catalogue(robot, [("drive", [])], "wombat-1")


def test_program_without_name_is_listed_while_it_serves_something(routers: Routers) -> None:
    with routers.connect("wombat-1", program=None) as robot, routers.connect("wombat-2") as other:
        until_catalogue(other, [], "wombat-1")
        service = robot.serve("grab", lambda request: "done")
        until_catalogue(other, [(None, ["grab"])], "wombat-1")
        service.close()
        until_catalogue(other, [], "wombat-1")


def test_second_server_of_topic_is_refused_until_first_ends(routers: Routers) -> None:
    with routers.connect("wombat-1", "arm") as arm, routers.connect("wombat-1", "claw") as claw:
        grab = arm.serve("grab", lambda request: "arm")
        for allow_several in (False, True):
            with pytest.raises(rect.ServiceRefused, match=r"^grab is served by the program arm already\. End that"):
                claw.serve("grab", lambda request: "claw", allow_several=allow_several)
        with pytest.raises(rect.ServiceRefused, match=r"^grab is served by this program already"):
            arm.serve("grab", lambda request: "arm")
        until_catalogue(claw, [("arm", ["grab"]), ("claw", [])])
        # The refused handlers receive nothing.
        with claw.request_all("grab", timeout=DEADLINE) as replies:
            assert [reply.value for reply in replies] == ["arm"]
        # The programs of one robot do not compete with those of another one.
        with routers.connect("wombat-2", "claw") as other:
            other.serve("grab", lambda request: "wombat-2")
        grab.close()
        claw.serve("grab", lambda request: "claw")
        until_catalogue(arm, [("arm", []), ("claw", ["grab"])])
        assert arm.request("wombat-1", "grab", timeout=DEADLINE).value == "claw"


def test_topic_is_free_when_its_program_is_killed(routers: Routers, tmp_path: Path) -> None:
    code = f"""
robot = rect.connect("wombat-1", router="{routers.endpoints["wombat-1"]}")
robot.serve("grab", lambda request: "arm")
print("serving", flush=True)
sys.stdin.read()
"""
    with routers.connect("wombat-1", "claw") as claw, script(tmp_path, "arm.py", code) as arm:
        assert line_of(arm) == "serving"
        with pytest.raises(rect.ServiceRefused, match="the program arm"):
            claw.serve("grab", lambda request: "claw")
        arm.kill()
        # No wait: the router may not have noticed the end of the program yet, and asks it whether it still answers.
        claw.serve("grab", lambda request: "claw")
        until_catalogue(claw, [("claw", ["grab"])])


def test_topic_of_program_that_does_not_answer_is_taken_over(
    routers: Routers, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    code = f"""
robot = rect.connect("wombat-1", router="{routers.endpoints["wombat-1"]}")
robot.serve("grab", lambda request: "arm")
print("serving", flush=True)
sys.stdin.read()
"""
    with routers.connect("wombat-1", "claw") as claw, script(tmp_path, "arm.py", code) as arm:
        assert line_of(arm) == "serving"
        stop(arm)
        with caplog.at_level(logging.WARNING, "rect"):
            claw.serve("grab", lambda request: "claw")
            until(lambda: "the program arm of this robot does not answer" in caplog.text, lambda: caplog.text)
        until_catalogue(claw, [("claw", ["grab"]), ("arm", [])])
        assert claw.request("wombat-1", "grab", timeout=DEADLINE).value == "claw"
        # The stopped program learns of it when it continues.
        arm.send_signal(signal.SIGCONT)
        until(lambda: [reply.value for reply in claw.request_all("grab")] == ["claw"])
        until_catalogue(claw, [("claw", ["grab"]), ("arm", [])])


def test_service_is_not_ended_by_another_program(routers: Routers) -> None:
    with routers.connect("wombat-1", "arm") as arm, routers.connect("wombat-2") as other:
        arm.serve("grab", lambda request: "arm")
        until_catalogue(other, [("arm", ["grab"])], "wombat-1")
        [program] = other.programs("wombat-1")
        # The query with which the router of a robot tells a program that another one serves its topic.
        assert list(other.zenoh.get(f"rect/wombat-1/grab?@taken={program.instance}")) == []
        assert other.request("wombat-1", "grab", timeout=DEADLINE).value == "arm"
        assert arm.request("wombat-1", "grab", timeout=DEADLINE).value == "arm"


def test_busy_program_keeps_its_topic(routers: Routers) -> None:
    began, proceed = threading.Event(), threading.Event()

    def grab(request: rect.Request) -> str:
        began.set()
        proceed.wait(DEADLINE)
        return "arm"

    with (
        routers.connect("wombat-1", "arm") as arm,
        routers.connect("wombat-1", "claw") as claw,
        ThreadPoolExecutor() as pool,
    ):
        arm.serve("grab", grab)
        # More requests than a service handles at once.
        requests = [
            pool.submit(claw.request, "wombat-1", "grab", timeout=DEADLINE) for _ in range(_rect.MAX_CONCURRENT + 1)
        ]
        assert began.wait(DEADLINE)
        with pytest.raises(rect.ServiceRefused, match="the program arm"):
            claw.serve("grab", lambda request: "claw")
        proceed.set()
        assert {request.result(DEADLINE).value for request in requests} == {"arm"}


def test_several_programs_that_allow_it_serve_one_topic(routers: Routers) -> None:
    received: list[str] = []
    with (
        routers.connect("wombat-1", "left") as left,
        routers.connect("wombat-1", "right") as right,
        routers.connect("wombat-2") as other,
    ):
        for robot, name in ((left, "left"), (right, "right")):

            def look(request: rect.Request, name: str = name) -> str:
                received.append(name)
                return name

            robot.serve("look", look, allow_several=True)
        until_catalogue(other, [("left", ["look"]), ("right", ["look"])], "wombat-1")

        def replies() -> list[str]:
            with other.request_all("look", timeout=DEADLINE) as replies:
                return sorted(reply.value for reply in replies)

        until(lambda: replies() == ["left", "right"])
        # A request to one robot reaches both programs, and returns the reply that arrives first.
        received.clear()
        reply = other.request("wombat-1", "look", timeout=DEADLINE)
        assert reply.value in ("left", "right")
        assert reply.is_shared
        until(lambda: sorted(received) == ["left", "right"], lambda: received)


def test_second_program_of_same_name_is_warned(routers: Routers, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "rect"), routers.connect("wombat-1", "arm") as arm:
        until_catalogue(arm, [("arm", [])])
        assert caplog.text == ""
        with routers.connect("wombat-1", "arm"):
            until(lambda: "another program arm runs at this robot" in caplog.text)
            until_catalogue(arm, [("arm", []), ("arm", [])])
    assert caplog.text.count("another program arm") == 1


def test_events_report_start_and_kill_of_program_at_once(routers: Routers, tmp_path: Path) -> None:
    code = f"""
robot = rect.connect("wombat-1", router="{routers.endpoints["wombat-1"]}")
print(time.monotonic(), flush=True)
sys.stdin.read()
"""
    delays: dict[str, float] = {}
    with (
        routers.connect("wombat-1", "drive") as local,
        routers.connect("wombat-2") as remote,
        program_events(local) as seen_locally,
        program_events(remote) as seen_remotely,
    ):
        # The programs that run already are reported, too, except for the observer itself.
        seen_remotely("program_up", "drive")
        with script(tmp_path, "arm.py", code) as arm:
            connected = float(line_of(arm))
            delays["up locally"] = seen_locally("program_up", "arm") - connected
            delays["up over the link"] = seen_remotely("program_up", "arm") - connected
            until_catalogue(remote, [("drive", []), ("arm", [])], "wombat-1")
            killed = time.monotonic()
            arm.kill()
            delays["down locally"] = seen_locally("program_down", "arm") - killed
            delays["down over the link"] = seen_remotely("program_down", "arm") - killed
        until_catalogue(remote, [("drive", [])], "wombat-1")
    print({what: f"{1000 * delay:.0f} ms" for what, delay in delays.items()})
    assert all(delay < AT_ONCE for delay in delays.values()), delays


def test_change_of_services_is_no_event(routers: Routers) -> None:
    with (
        routers.connect("wombat-2") as remote,
        program_events(remote) as seen,
        routers.connect("wombat-1", "arm") as arm,
    ):
        seen("program_up", "arm")
        began = time.monotonic()
        for number in range(3):
            # Each one is another revision of the program's token.
            arm.serve(f"topic-{number}", lambda request: "done").close()
            until_catalogue(remote, [("arm", [])], "wombat-1")
        # The next event is the end.
        arm.close()
        assert seen("program_down", "arm") > began


@contextmanager
def grabbing(routers: Routers, folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Runs a program that serves `grab`.

    It writes a line to the file `grabbed` and prints one for each request, and replies when it gets a line itself.
    """
    code = f"""
import threading
robot = rect.connect("wombat-1", router="{routers.endpoints["wombat-1"]}")
go = threading.Semaphore(0)

def grab(request):
    with open({str(folder / "grabbed")!r}, "a") as file:
        print(request.value, file=file)
    print("began", flush=True)
    go.acquire()
    return request.value

robot.serve("grab", grab)
print("serving", flush=True)
for _ in sys.stdin:
    go.release()
"""
    with script(folder, "grabber.py", code) as process:
        assert line_of(process) == "serving"
        yield process


def go(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    process.stdin.write("go\n")
    process.stdin.flush()


def test_retried_request_is_carried_out_once_although_the_link_is_cut(routers: Routers, tmp_path: Path) -> None:
    with routers.connect("wombat-2") as other, grabbing(routers, tmp_path) as arm, ThreadPoolExecutor(1) as pool:
        until_served(other, "wombat-1", "grab")
        asked = pool.submit(other.request, "wombat-1", "grab", "first", retry=True, timeout=2 * DEADLINE)
        assert line_of(arm) == "began"
        with routers.without_link():
            # The reply to the first query is lost.
            go(arm)
        assert asked.result(DEADLINE).value == "first"
        asked = pool.submit(other.request, "wombat-1", "grab", "second", retry=True, timeout=2 * DEADLINE)
        assert line_of(arm) == "began"
        with routers.without_link():
            pass
        go(arm)
        assert asked.result(DEADLINE).value == "second"
        assert (tmp_path / "grabbed").read_text().split() == ["first", "second"]


def test_retried_request_is_not_carried_out_by_a_program_that_was_restarted(routers: Routers, tmp_path: Path) -> None:
    with routers.connect("wombat-2") as other, ThreadPoolExecutor(1) as pool:
        with grabbing(routers, tmp_path) as arm:
            until_served(other, "wombat-1", "grab")
            asked = pool.submit(other.request, "wombat-1", "grab", "first", retry=True, timeout=2 * DEADLINE)
            assert line_of(arm) == "began"
            arm.kill()
        with grabbing(routers, tmp_path) as arm:
            with pytest.raises(rect.Interrupted):
                asked.result(DEADLINE)
            asked = pool.submit(other.request, "wombat-1", "grab", "second", retry=True, timeout=2 * DEADLINE)
            go(arm)
            assert asked.result(DEADLINE).value == "second"
        assert (tmp_path / "grabbed").read_text().split() == ["first", "second"]


def test_retried_request_whose_program_has_ended_for_good_is_interrupted_long_before_its_timeout(
    routers: Routers, tmp_path: Path
) -> None:
    with routers.connect("wombat-2") as other, ThreadPoolExecutor(1) as pool:
        with grabbing(routers, tmp_path) as arm:
            until_served(other, "wombat-1", "grab")
            asked = pool.submit(other.request, "wombat-1", "grab", "first", retry=True, timeout=20 * DEADLINE)
            assert line_of(arm) == "began"
            arm.kill()
        with pytest.raises(rect.Interrupted):
            asked.result(DEADLINE)


def test_retried_requests_of_asyncio_return_replies_errors_and_can_be_cancelled(
    routers: Routers, tmp_path: Path
) -> None:
    async def ask() -> list[object]:
        async with rect.aio.connect("wombat-2", router=routers.endpoints["wombat-2"]) as robot:
            reply = await robot.request("wombat-1", "double", 21, retry=True)
            with pytest.raises(rect.ServiceError, match="stuck"):
                await robot.request("wombat-1", "refuse", retry=True)
            with pytest.raises(rect.OptionError, match="at most 600 s"):
                await robot.request("wombat-1", "double", 21, retry=True, timeout=601)
            with pytest.raises(rect.NoService):
                await robot.request("wombat-1", "nothing", retry=True)
            waiting = asyncio.ensure_future(robot.request("wombat-1", "grab", "first", retry=True, timeout=500))
            assert await asyncio.to_thread(line_of, arm) == "began"
            waiting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await waiting
            return [reply.sender, reply.value]

    def refuse(request: rect.Request) -> None:
        raise rect.Refusal("it is stuck")

    with routers.connect("wombat-1", "double") as robot, grabbing(routers, tmp_path) as arm:
        robot.serve("double", lambda request: request.value * 2)
        robot.serve("refuse", refuse)
        with routers.connect("wombat-2") as other:
            for topic in ("double", "refuse", "grab"):
                until_served(other, "wombat-1", topic)
        assert asyncio.run(ask()) == ["wombat-1", 42]


def test_services_are_registered_again_after_restart_of_router(routers: Routers) -> None:
    with (
        routers.connect("wombat-1", "arm") as arm,
        routers.connect("wombat-2") as other,
        arm.events() as events,
        program_events(other) as seen,
    ):
        arm.serve("grab", lambda request: "done", about="closes the gripper")
        arm.serve("look", lambda request: "done")
        seen("program_up", "arm")
        router = routers.robots["wombat-1"]
        # The connection may be back before or after the router's catalogue.
        for _ in range(3):
            router.kill()
            while events.next(DEADLINE).kind != "router_down":
                pass
            seen("program_down", "arm")
            router.start()
            while events.next(DEADLINE).kind != "router_up":
                pass
            seen("program_up", "arm")
            # Programs that have not kept an earlier answer.
            for robot in ("wombat-1", "wombat-2"):
                with routers.connect(robot) as observer:
                    until_catalogue(observer, [("arm", ["grab", "look"])], "wombat-1")
                    assert observer.programs("wombat-1")[0].services[0].about == "closes the gripper"
            until_served(other, "wombat-1", "grab")
            assert other.request("wombat-1", "grab", timeout=DEADLINE).value == "done"


@pytest.mark.parametrize(
    ("file", "given", "expected"),
    [
        ("arm.py", "", "arm"),
        ("my arm", "", "my-arm"),
        ("arm.py", ', program="claw"', "claw"),
        ("arm.py", ", program=None", None),
        ("__main__.py", "", None),
    ],
)
def test_program_is_named_like_script_unless_name_is_given(
    tmp_path: Path, file: str, given: str, expected: str | None
) -> None:
    code = f"""
with rect.connect("wombat-1", listen=["tcp/127.0.0.1:{free_port()}"]{given}) as robot:
    print([program.name for program in robot.programs()])
"""
    with script(tmp_path, file, code) as process:
        assert line_of(process) == str([expected])


def test_tests_and_python_c_have_no_program_name() -> None:
    def code(port: int) -> str:
        return f'rect.connect("wombat-1", listen=["tcp/127.0.0.1:{port}"]).programs()[0].name'

    with rect.connect("wombat-1", listen=[f"tcp/127.0.0.1:{free_port()}"]) as robot:
        assert [program.name for program in robot.programs()] == [None]
    command = [sys.executable, "-c", f"import rect; print({code(free_port())})"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "None\n"


def test_invalid_program_names_are_rejected() -> None:
    for wrong in ("a b", "@rect", "*", "x" * 100):
        with pytest.raises(rect.InvalidNameError):
            rect.connect("wombat-1", listen=[f"tcp/127.0.0.1:{free_port()}"], program=wrong)


def test_linked_programs_without_router_answer_for_themselves() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with (
        rect.connect("wombat-1", listen=[endpoint], program="arm") as arm,
        rect.connect("wombat-2", endpoints=[endpoint]) as other,
        program_events(other) as seen,
    ):
        seen("program_up", "arm")
        arm.serve("grab", lambda request: "done", about="closes the gripper")
        with pytest.raises(rect.ServiceRefused, match=r"^grab is served by this program already"):
            arm.serve("grab", lambda request: "done")
        [program] = other.programs("wombat-1")
        assert program.name == "arm"
        assert program.services == (rect.ServiceEntry("grab", "closes the gripper", several=False),)
        arm.close()
        seen("program_down", "arm")


def test_missing_catalogue_is_no_service(routers: Routers) -> None:
    with (
        routers.connect("wombat-2") as robot,
        pytest.raises(rect.NoService, match="no program serves the registry"),
    ):
        robot.programs("wombat-9")


def test_async_programs_have_names_and_services(routers: Routers) -> None:
    async def run() -> None:
        def join(robot: str, program: str | None) -> rect.aio.Connecting:
            return rect.aio.connect(robot, router=routers.endpoints[robot], program=program)

        async with join("wombat-2", None) as other, other.events() as events:

            async def until_event(kind: str) -> None:
                async for event in events:
                    if event.program == "arm":
                        assert (event.kind, event.robot) == (kind, "wombat-1")
                        return

            async with join("wombat-1", "arm") as arm, join("wombat-1", "claw") as claw:
                await until_event("program_up")

                @arm.serve("grab")
                async def grab(request: rect.Request) -> str:
                    """Closes the gripper."""
                    return "arm"

                arm.serve("look", lambda request: "done", about="takes a picture", allow_several=True)
                programs = {program.name: program for program in await other.programs("wombat-1")}
                assert programs["arm"].services == (
                    rect.ServiceEntry("grab", "Closes the gripper.", several=False),
                    rect.ServiceEntry("look", "takes a picture", several=True),
                )
                with pytest.raises(rect.ServiceRefused, match="the program arm"):
                    claw.serve("grab", lambda request: "claw")
                claw.serve("look", lambda request: "done", allow_several=True)
                grab.close()
                claw.serve("grab", lambda request: "claw")
                assert (await claw.request("wombat-1", "grab", timeout=DEADLINE)).value == "claw"
            await until_event("program_down")

    asyncio.run(asyncio.wait_for(run(), 2 * DEADLINE))


def on_the_air(robot: rect.Robot) -> int:
    """Returns the bytes that a robot has sent to wombat-2, once no more are sent."""

    def sent() -> int:
        links = robot.connections(filter="peer=wombat-2;state=connected")
        return sum(link.sent["bytes"] or 0 for link in links if link.sent is not None)

    before, now = -1, sent()
    while now != before:
        # Longer than the pause between two revisions.
        time.sleep(1.2)
        before, now = now, sent()
    return now


def test_programs_cost_little_on_the_air(routers: Routers) -> None:
    """The budget: 60 bytes for the token of a program, 120 for a revision of what it serves, nothing while idle. A
    message of a link has up to 20 more."""
    with ExitStack() as stack:
        robot, other = (stack.enter_context(routers.connect(name)) for name in ("wombat-1", "wombat-2"))
        robot.wait_for_peer("wombat-2", DEADLINE)

        def cost(action: Callable[[], object]) -> int:
            before = on_the_air(robot)
            action()
            return on_the_air(robot) - before

        programs: list[rect.Robot] = []
        up = cost(lambda: programs.append(stack.enter_context(routers.connect("wombat-1", program="gripper"))))
        assert 0 < up <= 60 + 20
        [program] = programs
        plain = cost(lambda: program.zenoh.declare_queryable("rect/wombat-1/plain", print))
        served = cost(lambda: program.serve("other", print))
        assert 0 < served - plain <= 120 + 20
        topics = [f"topic-{number}" for number in range(10)]
        # The first revision is announced at once, and the next ones together after a second.
        ten = cost(lambda: [program.serve(topic, print) for topic in topics])
        assert ten <= 10 * (plain + 5) + 2 * 140
        asked = cost(lambda: other.programs("wombat-1"))
        again = cost(lambda: other.programs("wombat-1"))
        print(f"a program: {up} bytes; a queryable: {plain}; a service: {served}, ten: {ten}; the list: {asked}")
        assert again <= 5, "nothing has changed"
