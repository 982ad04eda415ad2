"""Runs the dashboard and headless Chromium, for its tests, its bench and its pictures."""

from __future__ import annotations

import json
import os
import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from playwright.sync_api import Browser, Page, Playwright
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


def list_topics(page: Page, count: int) -> None:
    """Makes a page list as many topics, instead of those that the routers count."""
    figures = {"robot": "wombat-2", "encoding": "application/json", "hz": 10.0, "bytes_per_s": 100, "last_bytes": 10}
    rows = [{**figures, "topic": f"sensor/{number}", "lost": 0} for number in range(count)]
    state = json.dumps({"type": "topics", "topics": rows, "more": 0, "problem": None})

    def serve(route: Any) -> None:
        server = route.connect_to_server()

        def pass_on(message: bytes) -> None:
            if b'"type":"topics"' in message:
                message = b"\x01" + state.encode()
            route.send(message)
            # The page takes messages now.
            if b'"type":"hello"' in message:
                route.send(b"\x01" + state.encode())

        server.on_message(pass_on)

    page.route_web_socket(re.compile("/socket$"), serve)


def launched(playwright: Playwright) -> Browser:
    """Starts Chromium without a sandbox and much shared memory, which containers lack. It opens only the dashboard."""
    path = os.environ.get("CHROMIUM", "/usr/bin/chromium")
    return playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-dev-shm-usage"])
