"""Hello: publishes a message, sends a request, and prints what another robot publishes. Start `rect sim` first.

python examples/hello/main.py
"""

from contextlib import suppress

import rect

with suppress(KeyboardInterrupt), rect.connect("wombat-1") as robot:
    # Every program that subscribes to greetings receives this.
    robot.publish("greeting", "hello")
    # Only this program receives the reply.
    battery = robot.request("wombat-2", "battery")
    print(f"battery of {battery.sender}: {battery.value}", flush=True)
    # Until Ctrl-C.
    for message in robot.subscribe("wombat-2/**"):
        print(f"{message.sender} {message.topic}: {message.value}", flush=True)
