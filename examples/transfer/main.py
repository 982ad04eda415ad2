"""Transfer: sends a file of any size to another robot. The transfer resumes after the link was interrupted.

python examples/transfer/main.py wombat-1                        # receives files into the folder `received`
python examples/transfer/main.py wombat-2 wombat-1 map.bin       # sends a file
"""

import sys
from contextlib import suppress

import rect

MAX_BYTES = 1 << 30  # Larger files are refused.


def main(me: str = "wombat-1", other: str = "", file: str = "") -> None:
    with rect.connect(me) as robot:
        if file:
            robot.transfer(other, "files", file, on_progress=lambda progress: print(f"{progress.fraction:4.0%}"))
            print(f"{file}: complete")
            return
        files = robot.receive_transfers("*/files", folder="received", max_bytes=MAX_BYTES)
        print(f"{robot.name} receives files; press Ctrl-C to stop", flush=True)
        for received in files:
            print(received.error or f"{received.name} from {received.sender}: {received.content}", flush=True)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main(*sys.argv[1:])
