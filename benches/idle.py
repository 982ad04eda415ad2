"""What a router takes when it has nothing to do: memory, threads, the program's size."""

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
        "An idle router: rect-router beside stock zenohd 1.10.2",
        ["program", "memory", "threads", "size", "size, stripped"],
    )
    memory_kb: dict[str, list[int]] = {program: [] for program in PROGRAMS}
    threads: dict[str, int] = {}
    for _ in range(ROUNDS):
        for program in PROGRAMS:
            with Router(program) as router:
                memory_kb[program].append(router.status("VmRSS"))
                threads[program] = router.status("Threads")
    for program, variable in PROGRAMS.items():
        path = Path(os.environ[variable])
        memory = f"{statistics.median(memory_kb[program]) / 1000:.1f} MB"
        table.add(program, memory, threads[program], megabytes(path), megabytes(path, strip=True))
    table.notes = [
        f"Resident memory once it listens on TCP, the median of {ROUNDS} starts, by turns. Wanted: at most 1 MB above "
        "stock. rect-router is built with LTO over everything in one codegen unit and stripped (profile `release`)."
    ]
    return table


def megabytes(program: Path, strip: bool = False) -> str:
    with tempfile.TemporaryDirectory() as folder:
        copy = shutil.copy(program, folder)
        if strip:
            subprocess.run(["strip", copy], check=True)
        return f"{Path(copy).stat().st_size / 1e6:.1f} MB"
