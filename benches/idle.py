"""Measures an idle router: memory, threads, the size of the program."""

import os
import shutil
import statistics
import subprocess
import tempfile
from pathlib import Path

from routers import PROGRAMS, Router
from table import Table

ROUNDS = 5


def run() -> Table:
    table = Table(
        "An idle router: rect-router compared with stock zenohd 1.10.2",
        ["program", "private memory", "resident memory (RSS)", "threads", "size", "size, stripped"],
    )
    own_kb: dict[str, list[int]] = {program: [] for program in PROGRAMS}
    resident_kb: dict[str, list[int]] = {program: [] for program in PROGRAMS}
    threads: dict[str, int] = {}
    for _ in range(ROUNDS):
        for program in PROGRAMS:
            with Router(program) as router:
                own_kb[program].append(router.own_kb())
                resident_kb[program].append(router.status("VmRSS"))
                threads[program] = router.status("Threads")
    for program, variable in PROGRAMS.items():
        path = Path(os.environ[variable])
        memory = [f"{statistics.median(kb[program]) / 1000:.1f} MB" for kb in (own_kb, resident_kb)]
        table.add(program, *memory, threads[program], megabytes(path), megabytes(path, strip=True))
    table.notes = [
        f"After it listens on TCP; medians of {ROUNDS} alternating starts. Private memory: heap, stacks, changed data "
        "(anonymous memory). Target: at most 1 MB above stock. The rest of the resident memory is program text, which "
        "the system may drop and read again. rect-router is built with LTO over everything in one codegen unit and "
        "stripped (profile `release`)."
    ]
    return table


def megabytes(program: Path, strip: bool = False) -> str:
    with tempfile.TemporaryDirectory() as folder:
        copy = shutil.copy(program, folder)
        if strip:
            subprocess.run(["strip", copy], check=True)
        return f"{Path(copy).stat().st_size / 1e6:.1f} MB"
