"""A program with mistakes that type checkers find, at these lines."""

from dataclasses import dataclass

import rect
from rect import aio


@dataclass
class Battery:
    percent: float


def drive(robot: rect.Robot) -> None:
    for message in robot.subscribe("*/battery", Battery):
        print(message.value.per_cent)  # wrong
        print(message.value["percent"])  # wrong
    robot.publisher("battery", Battery).publish({"percent": 80})  # wrong
    print(robot.request("wombat-2", "battery", returns=Battery).value.volt)  # wrong
    print(robot.wait_for_message("wombat-2/battery", Battery, timeout=1).value + 1)  # wrong


async def drive_async(robot: aio.Robot) -> None:
    reply = await robot.request("wombat-2", "battery", returns=Battery)
    print(reply.value.volt)  # wrong
    await robot.publisher("battery", Battery).publish(80)  # wrong
