"""State: a robot retains its mode. A program that starts later receives the last modes of all robots, and each change.

python examples/state/main.py wombat-1 auto      # retains the mode, and ends
python examples/state/main.py wombat-2           # prints the modes of all robots
python examples/state/main.py wombat-1 none      # forgets the mode
"""

import sys
from contextlib import suppress

import rect


def main(me: str = "wombat-1", mode: str = "") -> None:
    with rect.connect(me) as robot:
        if mode == "none":
            robot.forget("mode")
        elif mode:
            # The router of this robot keeps the value when this program ends.
            robot.publish("mode", mode, retained=True)
        else:
            # Until Ctrl-C. A topic that was forgotten has no value.
            for message in robot.subscribe("*/mode", str):
                age = message.retained.age if message.retained else 0
                print(f"{message.sender}: {message.value or 'none'}, for {age:.0f} s", flush=True)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main(*sys.argv[1:])
