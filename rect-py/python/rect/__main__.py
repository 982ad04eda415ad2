"""Owns `python -m rect ...` and `rect-router`: the router and its commands, which the wheel brings.

python -m rect sim                              # two simulated robots to play with
python -m rect router -l tcp/127.0.0.1:7447     # runs a router; everything after `router` is its own
python -m rect doctor                           # so is any other command: doctor, status, connections, scan, init
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import NoReturn

_ROUTER = Path(__file__).parent / "bin" / "rect-router"
#: Where another router is named than the wheel's.
_VARIABLE = "RECT_ROUTER"


def main() -> NoReturn:
    """`python -m rect`."""
    arguments = sys.argv[1:]
    if not arguments or arguments[0] in ("-h", "--help"):
        print((__doc__ or "").partition("\n\n")[2])
        raise SystemExit(0 if arguments else 2)
    _run(arguments[1:] if arguments[0] == "router" else arguments)


def router() -> NoReturn:
    """`rect-router`."""
    _run(sys.argv[1:])


def _run(arguments: list[str]) -> NoReturn:
    program = os.environ.get(_VARIABLE) or (str(_ROUTER) if _ROUTER.exists() else _elsewhere())
    if program is None:
        raise SystemExit(
            "this installation of rect has no router: install a wheel that brings it (`make dist` makes one), "
            "or name a rect-router by RECT_ROUTER"
        )
    os.execv(program, [program, *arguments])


def _elsewhere() -> str | None:
    """One that is installed otherwise, and is not the script that called this."""
    found = shutil.which("rect-router")
    is_this = found is not None and Path(found).resolve() == Path(sys.argv[0]).resolve()
    return None if is_this else found


if __name__ == "__main__":
    main()
