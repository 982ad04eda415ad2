"""The short form of `rect survey` between two robots on the Bluetooth stack of a real kernel.

Run by `tests/vm/test`."""

import json
import os
import subprocess
from contextlib import ExitStack
from pathlib import Path

from robots import Robot, rect_settings, wait_until

TOOL = os.environ.get("RECT_TOOL", "rect")


def survey(robot: Robot, *arguments: str) -> subprocess.Popen:
    command = [TOOL, "survey", *arguments, "--router", robot.endpoint(), "--as", robot.name]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def measure(folder: Path) -> str:
    """Returns the survey of two robots that are linked by Bluetooth."""
    result = folder / "survey.json"
    with ExitStack() as running:
        one, two = (
            Robot(name, adapter, folder / f"{name}.log", arguments=rect_settings({"robot": name}))
            for name, adapter in [("wombat-1", "hci0"), ("wombat-2", "hci1")]
        )
        for robot, dials in [(one, []), (two, ["ble/wombat-1"])]:
            running.callback(robot.kill)
            robot.start(dials)
        serving = survey(one, "--serve")
        running.callback(serving.kill)
        wait_until("the other side is ready", 30, lambda: "ready" in serving.stderr.readline())
        measuring = survey(two, one.name, "--here", "--duration", "1s", "--adapter", "hci1", "--output", str(result))
        _, output = measuring.communicate(timeout=120)
        assert measuring.returncode == 0, output
    return result.read_text()


def test_survey_describes_the_adapters_and_measures_the_link(tmp_path: Path):
    text = measure(tmp_path)
    found = json.loads(text)
    for robot in found["robots"]:
        assert [adapter["name"] for adapter in robot["computer"]["adapters"]] == ["hci0", "hci1"]
        assert robot["computer"]["outputs"]["hciconfig -a"]
    (place,) = found["places"]
    print(json.dumps(place))
    assert (place["path"], place["error"], place["discovery"]["error"]) == ("ble", None, None)
    assert len(place["discovery"]["seconds"]) == 5
    assert all(load["kb_per_s"] > 1 and load["lost"] == 0 for load in place["sent"] + place["received"])
    for adapter in ("hci0", "hci1"):
        address = subprocess.run(["adapter", "address", adapter], capture_output=True, text=True, check=True).stdout
        assert address.strip() not in text, "the survey contains the address of an adapter"
