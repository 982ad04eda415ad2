"""Stock zenohd with our plugin, and rect-router, on the Bluetooth stack of a real kernel. Run by `tests/vm/test`."""

import os
import time

import pytest
from conftest import exchange
from robots import PluginRobot, Robot

if not os.environ.get("RECT_PLUGIN"):
    pytest.skip("RECT_PLUGIN and RECT_ZENOHD are not set: run scripts/test-vm", allow_module_level=True)


PAIRINGS = [(Robot, PluginRobot), (PluginRobot, Robot), (PluginRobot, PluginRobot)]


@pytest.mark.parametrize("kinds", PAIRINGS, ids=lambda kinds: "-".join(kind.__name__ for kind in kinds))
def test_plugin_exchanges_messages_in_every_combination(tmp_path, kinds):
    one, two = (kind(f"wombat-{n + 1}", f"hci{n}", tmp_path / f"{n}.log") for n, kind in enumerate(kinds))
    try:
        one.start([])
        two.start(["ble/wombat-1"])
        started = time.monotonic()
        with one.session() as here, two.session() as there:
            exchange(here, there)
        print(f"both directions work after {time.monotonic() - started:.1f} s")
    finally:
        one.kill()
        two.kill()
