"""Request: a robot offers its battery's state as a service. Another robot sends requests to it, and to all robots.

python examples/request/main.py wombat-1             # offers the service
python examples/request/main.py wombat-2 wombat-1    # sends requests
"""

import sys
import threading
from contextlib import suppress

import rect


def battery(request: rect.Request) -> dict[str, object]:
    cell = request.value["cell"]
    if cell not in (1, 2):
        raise rect.Refusal("the cell must be 1 or 2")
    return {"cell": cell, "volt": 3.6}


def main(me: str = "wombat-1", other: str = "") -> None:
    with rect.connect(me) as robot:
        if not other:
            robot.serve("battery", battery)
            print(f"{robot.name} serves requests; press Ctrl-C to stop", flush=True)
            threading.Event().wait()
        # Only this call receives the reply. If the service replies with an error, the call raises `ServiceError`.
        reply = robot.request(other, "battery", {"cell": 1}, timeout=2)
        print(f"{reply.sender}: {reply.value}")
        try:
            for reply in robot.request_all("battery", {"cell": 9}, timeout=2):
                print(f"{reply.sender}: {reply.value}")
        except rect.ServiceError as error:
            print(error)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main(*sys.argv[1:])
