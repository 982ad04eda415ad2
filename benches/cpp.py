"""Compares the C++ library with the Rust library; micro-benchmarks, allocations, the size of a static program."""

import json
import os
import re
import statistics
import subprocess
import tempfile
import xml.etree.ElementTree as xml
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from comparison import IS_STEADY, alternate, ratio
from table import Table

REPOSITORY = Path(__file__).resolve().parents[1]
#: The same number in steady time, because the order in which threads get the only processor differs in each run.
ROUNDS = 30
SAMPLES = os.environ.get("RECT_BENCH_SAMPLES", "10" if IS_STEADY else "100")


@contextmanager
def prepared() -> Iterator[dict[str, str]]:
    """Builds the programs that are measured."""
    with tempfile.TemporaryDirectory() as folder:
        yield {"RECT_CPP_BUILT": str(build(Path(folder)))}


def run() -> Table:
    table = Table("The C++ library: two robots in one process, linked over TCP", ["what", "C++", "Rust", "C++ to Rust"])
    if IS_STEADY:
        measure(table, Path(os.environ["RECT_CPP_BUILT"]))
    else:
        with prepared() as environment:
            measure(table, Path(environment["RECT_CPP_BUILT"]))
            size = hello(Path(environment["RECT_CPP_BUILT"]))
            table.add("a stripped static program that prints hello", f"{size / 1e6:.1f} MB", "", "")
    table.notes = [
        f"The first two: medians of {ROUNDS} alternating runs each; the ratio is the median of the runs' ratios, "
        "with the range of the middle half in brackets. 58 bytes of JSON, from the call that publishes to the first "
        "line of the callback, which has a thread of its own in both. Target: at most 5 % more time.",
    ]
    return table


def measure(table: Table, built: Path) -> None:
    rust = os.environ["RECT_ROUNDS"]
    compare(table, "", [built / "benches" / "rect_rounds"], [rust])
    compare(table, "in Rust, with a type (in place of C++) and without: ", [rust, "typed"], [rust])
    command = [built / "benches" / "rect_bench", "--reporter", "xml", "--benchmark-samples", SAMPLES]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    for bench in xml.fromstring(output[output.index("<?xml") :]).iter("BenchmarkResults"):
        mean, deviation = (float(bench.find(part).attrib["value"]) for part in ("mean", "standardDeviation"))
        table.add(bench.attrib["name"], f"{mean / 1000:,.2f} us (sd {deviation / 1000:,.2f})", "", "")
    # In a separate run, because the report is XML.
    counted = subprocess.run([*command[:1], "a message"], capture_output=True, text=True, check=True).stdout
    found = re.search(r"published and received: ([\d.]+)", counted)
    assert found is not None
    table.add("heap allocations for a message, published and received", found[1], "", "")


def compare(table: Table, about: str, ours: list, theirs: list) -> None:
    rows = {"p50_us": "publish to callback, p50, us", "messages_per_s": "messages/s"}
    both = alternate(ROUNDS, lambda: figures(ours), lambda: figures(theirs))
    for key, what in rows.items():
        found = [[run[key] for run in runs] for runs in both]
        table.add(about + what, *(f"{statistics.median(rounds):,.0f}" for rounds in found), ratio(*found))


def figures(command: list) -> dict[str, float]:
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    # Catch2 prints lines, too.
    [line] = (line for line in output.splitlines() if line.startswith("{"))
    return json.loads(line)


def library() -> Path:
    return Path(os.environ["RECT_TOOL"]).parent


def build(folder: Path) -> Path:
    options = [f"-DRECT_LIBRARY_DIR={library()}", "-DCMAKE_BUILD_TYPE=Release", "-DRECT_BUILD_BENCHES=ON"]
    built = folder / "build"
    options += ["-DRECT_BUILD_EXAMPLES=OFF", "-G", "Ninja"]
    configure = ["cmake", "-S", REPOSITORY / "rect-cpp", "-B", built, *options]
    subprocess.run(configure, check=True, stdout=subprocess.DEVNULL)
    subprocess.run(
        ["cmake", "--build", built, "--target", "rect_bench", "rect_rounds"], check=True, stdout=subprocess.DEVNULL
    )
    return built


def hello(built: Path) -> int:
    program = built / "hello"
    source = REPOSITORY / "rect-cpp" / "tests" / "consumer" / "main.cpp"
    include = f"-I{REPOSITORY / 'rect-cpp' / 'include'}"
    link = [built / "lib" / "librect.a", "-Wl,--gc-sections", "-s", "-lpthread", "-ldl", "-lm", "-lgcc_s"]
    subprocess.run(["g++", "-std=c++17", "-O2", include, source, *link, "-o", program], check=True)
    subprocess.run([program], check=True, stdout=subprocess.DEVNULL)
    return program.stat().st_size


if __name__ == "__main__":
    print(run().text())
