"""Request and response: a robot serves its battery's state; another asks, and all are asked.

python examples/request/main.py wombat-1             # serves
python examples/request/main.py wombat-2 wombat-1    # asks
"""

import sys
import threading

import rect


def battery(request: rect.Request) -> dict[str, object]:
    cell = request.value["cell"]
    if cell not in (1, 2):
        raise rect.Refusal("there are the cells 1 and 2")
    return {"cell": cell, "volt": 3.6}


def main(me: str = "wombat-1", other: str = "") -> None:
    with rect.connect(me) as robot:
        if not other:
            robot.serve("battery", battery)
            print(f"{robot.name} serves; Ctrl-C ends this", flush=True)
            threading.Event().wait()
        # The answer comes to this call alone. An error of the service is an error here.
        reply = robot.request(other, "battery", {"cell": 1}, timeout=2)
        print(f"{reply.sender}: {reply.value}")
        try:
            for reply in robot.request_all("battery", {"cell": 9}, timeout=2):
                print(f"{reply.sender}: {reply.value}")
        except rect.ServiceError as error:
            print(error)


if __name__ == "__main__":
    main(*sys.argv[1:])
