"""Log: a robot logs lines, which `rect log` shows at any robot of the fleet, and raises an alert.

python examples/log/main.py wombat-1
"""

import logging
import sys

import rect

with rect.connect(sys.argv[1] if len(sys.argv) > 1 else "wombat-1") as robot:
    robot.log("ready")
    # From here on, the program's own `logging` does the same.
    logging.getLogger().addHandler(rect.LogHandler(robot))
    logging.warning("the gripper is slow", extra={"angle": 12.5})
    # Until robot.clear_alert("battery low").
    robot.alert("battery low")
