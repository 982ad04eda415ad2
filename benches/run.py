"""Runs the benches, each of which makes one comparison in one run, and writes the tables to `benches/results/`."""

import argparse
import contextlib
import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

from comparison import IS_STEADY

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "results"
sys.path.insert(0, str(HERE.parent / "examples" / "demo"))

BENCHES = {
    "goodput": "Zenoh over two routers compared with a raw L2CAP channel, on a real kernel's Bluetooth stack in the VM",
    "radio": "what each PHY and packet size carries, compared with a bare channel, on the simulated air",
    "conditions": "losses and ages of messages by radio condition: Bluetooth, TCP and UDP",
    "buffering": "more messages than the link carries: the size of the queue, ages and losses, beside stock Zenoh",
    "round_trip": "a Zenoh query over two routers compared with a bare channel's ping, on the simulated air",
    "on_air": "bytes of a message, bytes and time for establishing a link, on the simulated air",
    "loopback": "rect-router compared with stock zenohd on TCP loopback",
    "middleware": "the library compared with plain zenoh, gRPC and MQTT on TCP loopback: latency, messages/s, bytes",
    "urgent": "urgent messages during large transfers on a slow link: lanes, a plain link, stock zenohd over TCP",
    "flood": "the next message of a priority after a flood of messages on a slow link, with several limits",
    "declarations": "the effect of very many declarations of one program on two routers and their slow link",
    "urgent_vm": "two cases of `urgent` on a real kernel's Bluetooth stack in the VM, paced",
    "failover": "two robots whose Wi-Fi is silent or lost: any, Bluetooth alone, TCP alone, stock Zenoh with two links",
    "outages": "two robots after an outage of all radios: any, Bluetooth, TCP: when messages are back",
    "network": "the network path of an `any` link compared with `tls` and `tcp`: goodput, latency, memory (needs root)",
    "encryption": "a link with a secret compared with one without, on a real kernel's Bluetooth stack in the VM",
    "plugin": "RECT in a stock zenohd compared with rect-router: urgent messages, throughput, memory, threads",
    "isolation": "the effect of 98 other fleets behind the same stock router, without and with config/cloud.json5",
    "registry": "time to an answer with 5 and 500 connections, and until another router's registry shows a change",
    "codecs": "size and time of small JSON messages: JSON, CBOR, MessagePack, zstd without and with a dictionary",
    "stream": "a camera over a slow link, as video, adaptive and fixed: frames, ages, quality, urgent messages",
    "video_faults": "a camera's video while the radio is cut, or the Wi-Fi of an `any` link falls silent",
    "video_links": "a camera's video over links with Bluetooth alone, beside links that carry nothing",
    "actions": "actions compared with plain Zenoh: start and cancel, alone and beside 1 MB; feedback",
    "logs": "logs: urgent messages beside 10,000 lines a second, the last lines of a crash, memory",
    "throttle": "subscriptions that ask for fewer messages, compared with stock Zenoh's downsampling: bytes on the air",
    "state": "retained topics compared with zenoh-ext, MQTT and NetworkTables: a late subscriber, and after a cut",
    "parameters": "parameters compared with NetworkTables: a slider beside 1 MB, idle, a restart, a cut, a wrong type",
    "transfer": "a file of 5 MB over a slow link, without and with three cuts; concurrent urgent messages",
    "python": "the Python package compared with plain eclipse-zenoh: latency, frames, import time, memory",
    "cpp": "the C++ library compared with the Rust library, micro-benchmarks, allocations, size of a static program",
    "recording": "`rect record` and `rect replay`: processor time, memory, size beside the reference writer, timing",
    "dashboard": "a page of `rect dashboard`: bytes on the air, urgent messages, memory, processor time, time to open",
    "churn": "memory of a router whose neighbour is killed 200 times, beside stock zenohd",
    "idle": "memory, threads and size compared with stock zenohd",
}
#: The benches that also run in the VM's steady time. They need only loopback.
STEADY = ("middleware", "python", "cpp")


def module(name: str) -> ModuleType:
    """Imports a bench by its name, so that other processes find it, too; or by its file if Python has a module of that
    name."""
    if name not in sys.stdlib_module_names:
        return importlib.import_module(name)
    spec = importlib.util.spec_from_file_location(f"bench_{name}", HERE / f"{name}.py")
    assert spec is not None and spec.loader is not None
    bench = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(bench)
    return bench


def run(name: str) -> None:
    """Runs a bench in this process."""
    print(f"== {name}: {BENCHES[name]}", flush=True)
    table = module(name).run()
    print(table.text())
    profile = os.environ.get("RECT_PROFILE", "release")
    setting = "" if profile == "release" else f"RECT_PROFILE={profile} "
    option, suffix = ("--steady ", "_steady") if IS_STEADY else ("", "")
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{name}{suffix}.md").write_text(table.markdown(f"{setting}scripts/bench {option}{name}"))


def run_steadily(name: str) -> None:
    """Runs a bench in the VM without Bluetooth, with the programs that its `prepared` has built."""
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
    parser.add_argument(
        "bench", nargs="*", choices=[[], *BENCHES], metavar="BENCH", help="the benches to run (default: all)"
    )
    parser.add_argument(
        "--steady",
        action="store_true",
        help=f"run {', '.join(STEADY)} in the VM at the speed of a core of a Pi 3B, independent of the load",
    )
    parser.add_argument("--guest", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    chosen = arguments.bench or (STEADY if arguments.steady else BENCHES)
    if arguments.steady and not set(chosen) <= set(STEADY):
        parser.error(f"--steady works only with {', '.join(STEADY)}")
    for name in chosen:
        if arguments.guest:
            module(name).in_guest()
        elif arguments.steady:
            run_steadily(name)
        else:
            run(name)
    return 0


if __name__ == "__main__":
    sys.exit(main())
