"""Compares a link with the method `any` on its network path with a `tls/` and a plain `tcp/` link: goodput, round trip
and memory of two routers in two network namespaces."""

import os
import statistics
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import zenoh
from comparison import alternate, ratio
from robots import RobotError, open_client, wait_until
from routers import own_kb
from table import Table
from zenoh import CongestionControl, Priority

NEAR, FAR, PORT = "10.77.0.1", "10.77.0.2", 7460
NETWORKS = {"100 Mbit/s": "100mbit", "unlimited": None}
#: `tcp` with the batches of an `any` link, which Bluetooth limits.
SMALL_BATCHES = "tcp, 16 kB"
LINKS = ["any", "tls", "tcp", SMALL_BATCHES]
BATCH_BYTES = 16_000
SIZES = [1000, 8000, 100_000]
ROUNDS = 5
SECONDS = 2.0
ROUND_TRIPS = 300
IDLE_S = 4


def run() -> Table:
    columns = [
        "network",
        "link",
        *(f"put {size} B, MB/s" for size in SIZES),
        "round trip p50, us",
        "memory, kB",
        "idle processor, us/s",
    ]
    table = Table("The network path of an `any` link compared with `tls` and `tcp` links", columns)
    for network, rate in NETWORKS.items():
        print(f"  {network}", flush=True)
        rounds = alternate(ROUNDS, *(partial(figures, link, rate) for link in LINKS))
        by_link = {
            link: [list(column) for column in zip(*found, strict=True)]
            for link, found in zip(LINKS, rounds, strict=True)
        }
        for link, found in by_link.items():
            medians = [statistics.median(column) for column in found]
            rates, others = medians[: len(SIZES)], medians[len(SIZES) :]
            table.add(network, link, *(f"{value:.1f}" for value in rates), *(f"{value:.0f}" for value in others))
        for peer in LINKS[1:]:
            table.add(network, f"any to {peer}", *map(ratio, by_link["any"], by_link[peer]))
    table.notes = [
        f"Medians of {ROUNDS} rounds, in each of which all links run. Ratios: median of the rounds, with the range of "
        "the middle half. Stock eclipse-zenoh clients publish with congestion control Block. The routers "
        "run in two network namespaces with a pair of virtual Ethernet devices between them, limited by `tc` or not at "
        "all. The `any` link has only its network path. It is encrypted, as `tls` is; `tcp` is not. Zenoh sends "
        "batches of at most 16 kB on an `any` link, because each takes 0.5 s if it has to travel over Bluetooth, and "
        f"of 64 kB on the others, except `{SMALL_BATCHES}`. Memory: the private memory of the dialling router "
        "afterwards. Idle processor: its processor time while nothing is "
        "published.",
    ]
    return table


def figures(link: str, rate: str | None) -> list[float]:
    """Returns the figures of a link, in the order of the table's columns."""
    with pair(link, rate) as (near, far, pid):
        rates = [goodput(near, far, size) for size in SIZES]
        return [*rates, round_trip(near, far), own_kb(pid), idle_us(pid)]


@contextmanager
def pair(link: str, rate: str | None) -> Iterator[tuple[zenoh.Session, zenoh.Session, int]]:
    """Runs two routers that are linked. Yields a client of each, and the process of the dialling one."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        stack.enter_context(namespaces(rate))
        secret = folder / "secret"
        secret.write_text("team:the secret of the team\n")
        settings = certified(folder) if link == "tls" else []
        if link == SMALL_BATCHES:
            settings = ["--cfg", f"transport/link/tx/batch_size:{BATCH_BYTES}"]
        if link != "any":
            protocol = "tls" if link == "tls" else "tcp"
            listen, dial = f"{protocol}/{NEAR}:{PORT}", ["-e", f"{protocol}/{NEAR}:{PORT}"]
        else:
            options = f"wait=true;secret={secret}"
            listen = f"any/hci99#name=near;{options};port={PORT}"
            dial = ["-l", f"any/hci99#name=far;{options}", "-e", f"any/{NEAR}:{PORT}"]
        near = stack.enter_context(router(folder / "near", [], ["-l", listen, *settings]))
        far = stack.enter_context(router(folder / "far", ["ip", "netns", "exec", "rect-far"], [*dial, *settings]))
        sessions = [stack.enter_context(open_client(endpoint)) for endpoint, _ in (near, far)]
        wait_for_link(*sessions)
        yield sessions[0], sessions[1], far[1]


def certified(folder: Path) -> list[str]:
    """Makes a certificate of the near router that signs itself, and returns the settings of both routers for it."""
    key, certificate = folder / "key.pem", folder / "certificate.pem"
    command = [
        "openssl",
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:P-256",
        "-nodes",
        "-days",
        "1",
    ]
    command += ["-subj", "/CN=near", "-addext", f"subjectAltName=IP:{NEAR}", "-addext", "basicConstraints=CA:FALSE"]
    command += ["-keyout", key, "-out", certificate]
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
    files = {"listen_private_key": key, "listen_certificate": certificate, "root_ca_certificate": certificate}
    return [part for name, file in files.items() for part in ("--cfg", f'transport/link/tls/{name}:"{file}"')]


@contextmanager
def namespaces(rate: str | None) -> Iterator[None]:
    """Connects this network namespace with another one."""
    if os.geteuid() != 0:
        raise RobotError("this bench needs root, for its network namespace")

    def ip(command: str) -> None:
        subprocess.run(["ip", *command.split()], check=True)

    ip("netns add rect-far")
    try:
        ip("link add rect-near type veth peer name rect-far netns rect-far")
        for device, address, where in (("rect-near", NEAR, ""), ("rect-far", FAR, "-n rect-far ")):
            ip(f"{where}addr add {address}/24 dev {device}")
            ip(f"{where}link set {device} up")
            if rate:
                enter = ["ip", "netns", "exec", "rect-far"] if where else []
                limit = f"tc qdisc add dev {device} root tbf rate {rate} burst 32kb latency 50ms"
                subprocess.run([*enter, *limit.split()], check=True)
        ip("-n rect-far link set lo up")
        yield
    finally:
        # The kernel removes the devices of a namespace some time after it.
        ip("link del rect-near")
        ip("netns del rect-far")


@contextmanager
def router(at: Path, enter: list[str], arguments: list[str]) -> Iterator[tuple[str, int]]:
    """Runs a router. Yields the endpoint of its clients, and its process."""
    endpoint = f"unixsock-stream/{at}.sock"
    command = [*enter, os.environ["RECT_ROUTER"], "-l", endpoint, "--no-multicast-scouting", *arguments]
    with Path(f"{at}.log").open("w") as log:
        environment = os.environ | {"RUST_LOG": "warn"}
        process = subprocess.Popen(command, env=environment, stdout=log, stderr=subprocess.STDOUT)
    try:
        wait_until("the router is up", 20, Path(f"{at}.sock").exists)
        yield endpoint, process.pid
    finally:
        process.terminate()
        process.wait(10)


def wait_for_link(near: zenoh.Session, far: zenoh.Session) -> None:
    arrived = threading.Event()
    with far.declare_subscriber("hello", lambda _: arrived.set()):

        def has_arrived() -> bool:
            near.put("hello", b"")
            return arrived.wait(0.1)

        wait_until("the routers are linked", 20, has_arrived)


def goodput(near: zenoh.Session, far: zenoh.Session, size: int) -> float:
    """Returns the MB/s of payload from the first arrival to the last."""
    arrivals: list[float] = []
    ended = threading.Event()

    def on_sample(sample: zenoh.Sample) -> None:
        if len(sample.payload) == 1:
            ended.set()
        else:
            arrivals.append(time.perf_counter())

    with far.declare_subscriber("load", on_sample):
        wait_for_link(near, far)
        payload = zenoh.ZBytes(bytes(size))
        publisher = near.declare_publisher("load", congestion_control=CongestionControl.BLOCK)
        until = time.perf_counter() + SECONDS
        while time.perf_counter() < until:
            publisher.put(payload)
        publisher.put(b"0")
        if not ended.wait(30):
            raise RobotError("the last message did not arrive")
    return (len(arrivals) - 1) * size / (arrivals[-1] - arrivals[0]) / 1e6


def idle_us(pid: int) -> float:
    """Returns the processor time of an idle process, in microseconds per second."""

    def used_ns() -> int:
        return sum(int(path.read_text().split()[0]) for path in Path(f"/proc/{pid}/task").glob("*/schedstat"))

    time.sleep(1)  # The work of the earlier measurements ends.
    before, start = used_ns(), time.perf_counter()
    time.sleep(IDLE_S)
    return (used_ns() - before) / 1000 / (time.perf_counter() - start)


def round_trip(near: zenoh.Session, far: zenoh.Session) -> float:
    """Returns the median of the round trips of a small message, in microseconds."""
    returned = threading.Event()
    options = {"congestion_control": CongestionControl.BLOCK, "express": True, "priority": Priority.DATA}
    back, there = far.declare_publisher("back", **options), near.declare_publisher("there", **options)
    with (
        far.declare_subscriber("there", lambda sample: back.put(sample.payload)),
        near.declare_subscriber("back", lambda _: returned.set()),
    ):
        wait_for_link(near, far)
        wait_for_link(far, near)
        times = []
        for _ in range(ROUND_TRIPS):
            returned.clear()
            start = time.perf_counter()
            there.put(b"12345678")
            if not returned.wait(10):
                raise RobotError("a message did not return")
            times.append(time.perf_counter() - start)
    return statistics.median(times) * 1e6
