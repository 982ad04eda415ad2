"""Dig: a robot carries out a long task, which another one starts, follows and cancels.

python examples/dig/main.py wombat-2               # digs when it is asked to
python examples/dig/main.py wombat-1 wombat-2 5    # asks wombat-2 to dig 5 cm deep, and prints how it goes
"""

import sys
import threading
from contextlib import suppress

import rect


def dig(goal: rect.Goal[int]) -> str:
    for done in range(goal.value):
        goal.feedback(f"{done} cm", progress=done / goal.value)
        # Raises `rect.Cancelled` if the goal is cancelled: then nothing more is dug.
        goal.sleep(0.5)
    return f"a hole of {goal.value} cm"


def main(me: str = "wombat-1", digger: str = "", depth: str = "5") -> None:
    with rect.connect(me) as robot:
        if not digger:
            robot.action("dig", dig)
            print("ready to dig, until Ctrl-C", flush=True)
            threading.Event().wait()
        run = robot.start(digger, "dig", int(depth), returns=str)
        for feedback in run:
            print(f"{feedback.value}, {100 * (feedback.progress or 0):.0f} %", flush=True)
        # The result, or an `ActionError`: the goal has failed, or was refused, cancelled or preempted.
        print(run.result())


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main(*sys.argv[1:])
