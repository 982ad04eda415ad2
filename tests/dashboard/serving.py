"""Runs the dashboard and headless Chromium, for its tests, its bench and its pictures."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, Page, Playwright
from robots import free_port


@contextmanager
def dashboard(endpoint: str, *options: str) -> Iterator[tuple[str, int]]:
    """Runs `rect dashboard` at a router; yields its address and its process."""
    command = [os.environ["RECT_TOOL"], "dashboard", "--router", endpoint, *options]
    if "--listen" not in options:
        command += ["--listen", f"127.0.0.1:{free_port()}"]
    # The robots of these tests require no login, whichever file this computer has.
    environment = {**os.environ, "RECT_LOGIN": os.devnull}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr
        try:
            for line in process.stderr:
                if "in a browser" in line:
                    yield line.split()[2], process.pid
                    return
            raise AssertionError(f"the dashboard has ended: {command}")
        finally:
            process.terminate()


#: Replaces the list of topics in what the page receives, within the browser.
LIST_TOPICS = """
const rows = Array.from({ length: COUNT }, (_, number) => ({
  robot: "wombat-2", topic: `sensor/${number}`, encoding: "application/json", hz: 10, bytes_per_s: 100, last_bytes: 10,
  lost: 0,
}));
const state = JSON.stringify({ type: "topics", topics: rows, more: 0, problem: null });
const listed = new Uint8Array([1, ...new TextEncoder().encode(state)]).buffer;
window.WebSocket = class extends WebSocket {
  constructor(...where) {
    super(...where);
    this.addEventListener("message", (event) => {
      const head = new TextDecoder().decode(new Uint8Array(event.data, 0, Math.min(40, event.data.byteLength)));
      const isList = head.includes('"type":"topics"') && event.isTrusted;
      if (isList) {
        event.stopImmediatePropagation();
      }
      if (isList || head.includes('"type":"hello"')) {
        queueMicrotask(() => this.dispatchEvent(new MessageEvent("message", { data: listed })));
      }
    });
  }
};
"""


def list_topics(page: Page, count: int) -> None:
    """Makes a page list as many topics, instead of those that the routers count."""
    page.add_init_script(LIST_TOPICS.replace("COUNT", str(count)))


def launched(playwright: Playwright) -> Browser:
    """Starts Chromium without a sandbox and much shared memory, which containers lack. It opens only the dashboard."""
    path = os.environ.get("CHROMIUM", "/usr/bin/chromium")
    return playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-dev-shm-usage"])
