"""Runs the part of a bench that needs the VM with a real kernel's Bluetooth stack: `in_guest` of its module."""

import json
import subprocess
import sys
from pathlib import Path

from comparison import STEADY_PROCESSOR

#: The components that share the VM's processor, for the captions.
CLOCK = f"The guest, with both routers, their programs and the emulated controllers: {STEADY_PROCESSOR}."
# The largest number of the host's seconds that one of the guest's may take.
SLOWER = 4
ROOT = Path(__file__).resolve().parents[1]


def figures_of(bench: str, limit_s: int, controllers: int = 2) -> list[dict]:
    """Returns the JSON lines that `in_guest` prints within a time limit in the guest's seconds. Prints its other
    lines."""
    command = ["tests/vm/run", "--steady", "--timeout", str(SLOWER * limit_s), "--controllers", str(controllers), "--"]
    command += [sys.executable, "benches/run.py", "--guest", bench]
    guest = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    figures = []
    for line in guest.stdout:
        if line.startswith("{"):
            figures.append(json.loads(line))
        else:
            print(line, end="", flush=True)
    if guest.wait() != 0:
        raise SystemExit(f"{bench}: the run in the VM failed (exit status {guest.returncode})")
    return figures


def set_pace(adapters: list[str], bytes_per_s: int) -> None:
    """Sets the pace of the adapters' radios, in the guest."""
    for adapter in adapters:
        subprocess.run(["room", "pace", adapter, str(bytes_per_s)], check=True)
