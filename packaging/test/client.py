"""A client of stock Zenoh on the robot: logs in, publishes and receives its own message."""

import json
import time
from pathlib import Path

import zenoh

user, password = Path("/etc/rect/users").read_text().splitlines()[0].split(":", 1)
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", '["tcp/127.0.0.1:7447"]')
config.insert_json5("connect/timeout_ms", "20000")
# The endpoint is known, and programs in qemu-user cannot list network interfaces.
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("transport/auth/usrpwd", json.dumps({"user": user, "password": password}))
with zenoh.open(config) as sender, zenoh.open(config) as receiver:
    subscriber = receiver.declare_subscriber("rect/wombat-1/greeting")
    publisher = sender.declare_publisher("rect/wombat-1/greeting")
    deadline = time.monotonic() + 20
    message = None
    while message is None:
        assert time.monotonic() < deadline, "no message was received"
        publisher.put("hello")
        message = subscriber.try_recv()
        time.sleep(0.05)
    assert message.payload.to_string() == "hello", message
print("received")
