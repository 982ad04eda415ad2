"""A stock program on the robot: logs in, asks for what it said itself."""

import json
import time
from pathlib import Path

import zenoh

user, password = Path("/etc/rect/users").read_text().splitlines()[0].split(":", 1)
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", '["tcp/127.0.0.1:7447"]')
config.insert_json5("connect/timeout_ms", "20000")
# It knows where its router is; qemu-user tells programs of no interfaces.
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("transport/auth/usrpwd", json.dumps({"user": user, "password": password}))
with zenoh.open(config) as here, zenoh.open(config) as there:
    heard = there.declare_subscriber("rect/wombat-1/said")
    said = here.declare_publisher("rect/wombat-1/said")
    deadline = time.monotonic() + 20
    message = None
    while message is None:
        assert time.monotonic() < deadline, "nothing was heard"
        said.put("hello")
        message = heard.try_recv()
        time.sleep(0.05)
    assert message.payload.to_string() == "hello", message
print("heard")
