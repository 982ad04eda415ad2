"""Runs `python -m rect ...`, `rect` and `rect-router`: the command-line tool and the router, which the wheel contains.

python -m rect sim                              # runs two simulated robots
python -m rect peers                            # runs another command of `rect`: sub, pub, request, air, doctor, ...
python -m rect router -l tcp/127.0.0.1:7447     # runs a router; the arguments after `router` are passed on to it

`python -m rect --help` lists all commands.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import NoReturn

_BIN = Path(__file__).parent / "bin"
#: Environment variables with the paths of programs to use instead of the wheel's.
_VARIABLES = {"rect": "RECT_TOOL", "rect-router": "RECT_ROUTER"}


def main() -> NoReturn:
    """Runs `python -m rect`."""
    arguments = sys.argv[1:]
    if not arguments:
        print(__doc__)
        raise SystemExit(2)
    if arguments[0] == "router":
        _run("rect-router", arguments[1:])
    _run("rect", arguments)


def tool() -> NoReturn:
    """Runs `rect`."""
    _run("rect", sys.argv[1:])


def router() -> NoReturn:
    """Runs `rect-router`."""
    _run("rect-router", sys.argv[1:])


def _run(name: str, arguments: list[str]) -> NoReturn:
    own = _BIN / name
    program = os.environ.get(_VARIABLES[name]) or (str(own) if own.exists() else _elsewhere(name))
    if program is None:
        raise SystemExit(
            f"this installation of rect does not contain the program {name}: install a wheel that contains it "
            f"(`make dist` builds one), or set {_VARIABLES[name]} to the path of {name}"
        )
    os.execv(program, [program, *arguments])


def _elsewhere(name: str) -> str | None:
    """Returns the path of the program if it is installed separately, unless that is the script that runs now."""
    found = shutil.which(name)
    is_this = found is not None and Path(found).resolve() == Path(sys.argv[0]).resolve()
    return None if is_this else found


if __name__ == "__main__":
    main()
