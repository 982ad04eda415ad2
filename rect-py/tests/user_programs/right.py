"""A program that type checkers accept."""

from dataclasses import dataclass

import rect
from rect import aio


@dataclass
class Battery:
    percent: float


@dataclass
class Grab:
    force: float


def drive(robot: rect.Robot) -> None:
    for message in robot.subscribe("*/battery", Battery):
        if message.problem is None:
            print(message.sender, message.value.percent + 1)
    robot.publisher("battery", Battery).publish(Battery(80))
    robot.subscribe("*/battery", Battery, callback=on_battery)
    robot.subscribe("*/battery", callback=lambda message: print(message.value["percent"]))
    numbers: rect.Subscriber[list[float]] = robot.subscribe("*/scan", list[float])
    print(sum(numbers.next(timeout=1).value))
    print(robot.wait_for_message("wombat-2/battery", Battery, timeout=1).value.percent)
    print(robot.request("wombat-2", "grab", Grab(2.5), returns=Battery).value.percent)
    print([reply.value.percent for reply in robot.request_all("grab", returns=Battery)])
    print(robot.request("wombat-2", "grab").value["percent"])

    @robot.serve("grab")
    def grab(request: rect.Request[Grab]) -> Battery:
        return Battery(request.value.force)

    robot.serve("grab", grab)


def on_battery(message: rect.Message[Battery]) -> None:
    print(message.value.percent)


def untyped(message: rect.Message) -> None:
    print(message.value["percent"])


async def drive_async(robot: aio.Robot) -> None:
    async for message in robot.subscribe("*/battery", Battery):
        print(message.value.percent)
    reply = await robot.request("wombat-2", "grab", returns=Battery)
    print(reply.value.percent)
    await robot.publisher("battery", Battery).publish(Battery(80))
