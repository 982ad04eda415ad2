"""`make bench`: each comparison in one run, side by side; tables are printed and kept in `benches/results/`."""

import argparse
import contextlib
import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

from turns import IS_STEADY

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "results"
sys.path.insert(0, str(HERE.parent / "examples" / "demo"))

BENCHES = {
    "goodput": "Zenoh over two routers beside a raw L2CAP channel, on a real kernel's Bluetooth stack in the VM",
    "round_trip": "a Zenoh query over two routers beside a bare channel's ping, on the simulated air",
    "on_air": "bytes a message takes, bytes and time to bring a link up, on the simulated air",
    "loopback": "rect-router beside stock zenohd on TCP loopback",
    "middleware": "the library beside plain zenoh, gRPC and MQTT on TCP loopback: latency, messages/s, bytes",
    "urgent": "urgent messages beside something large on a slow link: lanes, a plain link, stock zenohd over TCP",
    "flood": "the next message of a priority after a flood of small ones on a slow link, with several bounds",
    "declarations": "what one program with very many declarations does to two routers and the slow link between them",
    "urgent_vm": "the same two cases of it on a real kernel's Bluetooth stack in the VM, paced",
    "lanes_cost": "throughput and round trip of lanes beside a plain link, unpaced, in the VM",
    "plugin": "RECT in a stock zenohd beside rect-router: urgent messages, throughput, memory, threads",
    "registry": "time to an answer with 5 and 500 connections; 20 routers agree on a change",
    "codecs": "size and time of small JSON messages: JSON, CBOR, MessagePack, zstd without and with a dictionary",
    "stream": "a camera over a slow link, adaptive and fixed: frames, ages, quality, urgent messages the while",
    "transfer": "a file of 5 MB over a slow link, whole and with three cuts; urgent messages the while",
    "python": "the Python package beside plain eclipse-zenoh: latency, frames, import time, memory",
    "cpp": "the C++ library beside the Rust library, its micro-benchmarks, allocations, the size of a static program",
    "idle": "memory, threads and size beside stock zenohd",
}
#: What runs in the VM's steady time, too: programs alone, on loopback.
STEADY = ("middleware", "python", "cpp")


def module(name: str) -> ModuleType:
    """By its name, by which a process of its own finds it too; by its file where Python itself has one of that name."""
    if name not in sys.stdlib_module_names:
        return importlib.import_module(name)
    spec = importlib.util.spec_from_file_location(f"bench_{name}", HERE / f"{name}.py")
    assert spec is not None and spec.loader is not None
    bench = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(bench)
    return bench


def run(name: str) -> None:
    """Here and now."""
    print(f"== {name}: {BENCHES[name]}", flush=True)
    table = module(name).run()
    print(table.text())
    profile = os.environ.get("RECT_PROFILE", "release")
    setting = "" if profile == "release" else f"RECT_PROFILE={profile} "
    option, suffix = ("--steady ", "_steady") if IS_STEADY else ("", "")
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{name}{suffix}.md").write_text(table.markdown(f"{setting}scripts/bench {option}{name}"))


def run_steadily(name: str) -> None:
    """The same in the VM without Bluetooth, with what its `prepared` has built for it."""
    bench = module(name)
    with bench.prepared() if hasattr(bench, "prepared") else contextlib.nullcontext({}) as prepared:
        command = [HERE.parent / "tests" / "vm" / "run", "--steady", "--controllers", "0", "--timeout", "7200"]
        command += ["--share", RESULTS, "--", sys.executable, __file__, name]
        subprocess.run(command, env=os.environ | prepared | {"RECT_STEADY": "1"}, check=True)


def main() -> int:
    listed = "\n".join(f"  {name:<11} {text}" for name, text in BENCHES.items())
    parser = argparse.ArgumentParser(
        prog="scripts/bench", description=__doc__, epilog=listed, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bench", nargs="*", choices=[[], *BENCHES], metavar="BENCH", help="which (none: all)")
    parser.add_argument(
        "--steady",
        action="store_true",
        help=f"{', '.join(STEADY)} in the VM, in the time of a core of a Pi 3B: nothing else the machine does counts",
    )
    parser.add_argument("--guest", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    wanted = arguments.bench or (STEADY if arguments.steady else BENCHES)
    if arguments.steady and not set(wanted) <= set(STEADY):
        parser.error(f"--steady is for {', '.join(STEADY)}")
    for name in wanted:
        if arguments.guest:
            module(name).in_guest()
        elif arguments.steady:
            run_steadily(name)
        else:
            run(name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
