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
    """Starts a router of no robot, makes its endpoint the default in RECT_ENDPOINT, and yields the endpoint."""
    yield from _router(monkeypatch)


@pytest.fixture
def own_router(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Starts the router of wombat-1, which keeps retained values, and sets RECT_ENDPOINT to its endpoint."""
    connections = tmp_path / "connections.json"
    connections.write_text('{"connections": []}')
    settings = ('plugins/rect/robot:"wombat-1"', f'plugins/rect/connections:"{connections}"')
    for _ in _router(monkeypatch, *(part for setting in settings for part in ("--cfg", setting))):
        yield


def _router(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> Iterator[str]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    monkeypatch.setenv("RECT_ENDPOINT", endpoint)
    router = [os.environ.get("RECT_ROUTER", "rect-router"), "-l", endpoint, "--no-multicast-scouting", *arguments]
    with subprocess.Popen(router) as process:
        try:
            yield endpoint
        finally:
            process.terminate()


@pytest.fixture
def simulation(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Runs the simulated robots wombat-1 and wombat-2. Programs connect to wombat-1 by default."""
    command = [os.environ.get("RECT_ROUTER", "rect-router"), "sim", "--port", "0"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            endpoints = (line.split()[1] for line in process.stdout if line.startswith("wombat-1  tcp/"))
            monkeypatch.setenv("RECT_ENDPOINT", next(endpoints))
            yield
        finally:
            process.terminate()
