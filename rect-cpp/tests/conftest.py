"""Provides the build folder of the examples, and a router for them."""

from __future__ import annotations

import os
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--build", type=Path, required=True, help="the build folder of CMake")


@pytest.fixture
def build(request: pytest.FixtureRequest) -> Path:
    folder: Path = request.config.getoption("--build")
    return folder


@pytest.fixture
def endpoint(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Starts a router, makes its endpoint the default in RECT_ENDPOINT, and yields the endpoint."""
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
