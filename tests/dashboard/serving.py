"""Runs the dashboard and headless Chromium, for its tests, its bench and its pictures."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, Playwright
from robots import free_port


@contextmanager
def dashboard(endpoint: str, *options: str) -> Iterator[tuple[str, int]]:
    """Runs `rect dashboard` at a router; yields its address and its process."""
    command = [os.environ["RECT_TOOL"], "dashboard", "--router", endpoint, *options]
    if "--listen" not in options:
        command += ["--listen", f"127.0.0.1:{free_port()}"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr
        try:
            for line in process.stderr:
                if "in a browser" in line:
                    yield line.split()[2], process.pid
                    return
            raise AssertionError(f"the dashboard has ended: {command}")
        finally:
            process.terminate()


def launched(playwright: Playwright) -> Browser:
    """Starts Chromium without a sandbox and much shared memory, which containers lack. It opens only the dashboard."""
    path = os.environ.get("CHROMIUM", "/usr/bin/chromium")
    return playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-dev-shm-usage"])
