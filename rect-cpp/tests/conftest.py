"""Where the examples are built, and a router for them."""

from __future__ import annotations

import os
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--build", type=Path, required=True, help="CMake's build folder")


@pytest.fixture
def build(request: pytest.FixtureRequest) -> Path:
    folder: Path = request.config.getoption("--build")
    return folder


@pytest.fixture
def endpoint(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A router for programs that name none."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    monkeypatch.setenv("RECT_ENDPOINT", endpoint)
    router = [os.environ.get("RECT_ROUTER", "rect-router"), "-l", endpoint, "--no-multicast-scouting"]
    with subprocess.Popen(router) as process:
        try:
            yield endpoint
        finally:
            process.terminate()
