"""Transfer: a file of any size goes to another robot, over a radio that comes and goes.

python examples/transfer/main.py wombat-1                        # takes files, into the folder `received`
python examples/transfer/main.py wombat-2 wombat-1 map.bin       # sends one
"""

import sys

import rect


def main(me: str = "wombat-1", other: str = "", file: str = "") -> None:
    with rect.connect(me) as robot:
        if file:
            robot.transfer(other, "files", file, on_progress=lambda progress: print(f"{progress.fraction:4.0%}"))
            print(f"{file} is there, whole")
            return
        # Whoever sends more is refused.
        files = robot.receive_transfers("*/files", folder="received", max_bytes=1 << 30)
        print(f"{robot.name} takes files; Ctrl-C ends this", flush=True)
        for received in files:
            print(received.error or f"{received.name} of {received.sender}: {received.content}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
