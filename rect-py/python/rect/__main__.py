"""Runs `python -m rect ...` and `rect-router`: the router and its commands, which the wheel contains.

python -m rect sim                              # runs two simulated robots
python -m rect router -l tcp/127.0.0.1:7447     # runs a router; the arguments after `router` are passed on to it
python -m rect doctor                           # runs another command: doctor, status, connections, scan, init
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import NoReturn

_ROUTER = Path(__file__).parent / "bin" / "rect-router"
#: Environment variable with the path of a router to use instead of the wheel's.
_VARIABLE = "RECT_ROUTER"


def main() -> NoReturn:
    """Runs `python -m rect`."""
    arguments = sys.argv[1:]
    if not arguments or arguments[0] in ("-h", "--help"):
        print((__doc__ or "").partition("\n\n")[2])
        raise SystemExit(0 if arguments else 2)
    _run(arguments[1:] if arguments[0] == "router" else arguments)


def router() -> NoReturn:
    """Runs `rect-router`."""
    _run(sys.argv[1:])


def _run(arguments: list[str]) -> NoReturn:
    program = os.environ.get(_VARIABLE) or (str(_ROUTER) if _ROUTER.exists() else _elsewhere())
    if program is None:
        raise SystemExit(
            "this installation of rect has no router: install a wheel that contains it (`make dist` builds one), "
            "or set RECT_ROUTER to the path of a rect-router"
        )
    os.execv(program, [program, *arguments])


def _elsewhere() -> str | None:
    """Returns the path of a `rect-router` that is installed separately, unless it is the script that runs now."""
    found = shutil.which("rect-router")
    is_this = found is not None and Path(found).resolve() == Path(sys.argv[0]).resolve()
    return None if is_this else found


if __name__ == "__main__":
    main()
