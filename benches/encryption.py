"""Compares a link with a secret, which is encrypted, with one without, on a real kernel's Bluetooth stack.

The guest's processor has no AES instructions, like that of a Raspberry Pi 3B."""

import itertools
import json
import statistics
import tempfile
import time
from pathlib import Path

import zenoh
from goodput import MAX_PUTS, put_rate
from guest import CLOCK, figures_of, set_pace
from peers import bare_channel
from robots import Robot, wait_until
from round_trip import ask
from routers import own_kb
from table import Table
from traffic import Urgent, bulk, percentile

PACES = [34_000, 100_000, 0]
ROUNDS = 3
SECONDS = 5
UNPACED_BYTES = 500_000
SDU_BYTES = [2000, 4000]
PUT_BYTES = [1000, 16_000]
BULK_LIMIT_S = 60
QUERIES = 80
PAYLOAD = bytes(64)
# The name of the dialled robot, the adapters.
LINKS = {"encrypted": ("wombat-1", "hci0", "hci1"), "not encrypted": ("wombat-3", "hci2", "hci3")}
SECRET = "fleet:a secret of the team, long enough"
TARGET, TARGETED = 0.96, "share of raw, put 16000 B"


def run() -> Table:
    table = Table(
        "A link with a secret compared with one without, on a real kernel's Bluetooth stack",
        ["pace", "what", *LINKS, "ratio", "target"],
    )
    for pace, found in itertools.groupby(figures_of("encryption", 2400, controllers=4), key=lambda f: f["pace"]):
        rounds = list(found)
        for what in rounds[0]["encrypted"]:
            links = [[figures[link][what] for figures in rounds] for link in LINKS]
            ratios = [ours / others for ours, others in zip(*links, strict=True)]
            cells = (f"{statistics.median(values):.4g}" for values in links)
            target = f"encrypted: at least {TARGET}" if what == TARGETED and pace else ""
            pace_text = f"{pace / 1000:.0f} kB/s" if pace else "none"
            table.add(pace_text, what, *cells, f"{statistics.median(ratios):.3f}", target)
    table.notes = [
        f"Medians of {ROUNDS} alternating rounds, and of the ratios of each round. Stock eclipse-zenoh clients and two "
        "routers for each link. Goodput: from the first put to the last arrival; its share of a bare L2CAP channel at "
        "its best SDU size in the same round. Urgent: 16 bytes every 50 ms beside a message of "
        f"{SECONDS} seconds. Processor time: of the sending router, for each message.",
        "Without a pace the emulated processor is the limit, and it also runs the emulated controllers.",
        CLOCK,
        "AES runs in software there, as on a Raspberry Pi 3B, whose cores have no instructions for it.",
    ]
    return table


def in_guest() -> None:
    for pace in PACES:
        set_pace([adapter for _, *adapters in LINKS.values() for adapter in adapters], pace)
        for n in range(ROUNDS):
            print(f"  pace {pace or 'none'}, round {n + 1} of {ROUNDS}", flush=True)
            # The links alternate in going first.
            order = list(LINKS) if n % 2 else list(reversed(LINKS))
            figures = {}
            for link in order:
                with tempfile.TemporaryDirectory() as folder:
                    figures[link] = measured(link, pace, Path(folder))
            print(json.dumps({"pace": pace} | figures), flush=True)


def measured(link: str, pace: int, folder: Path) -> dict[str, float]:
    name, near, far = LINKS[link]
    secret = folder / "secret"
    secret.write_text(f"{SECRET}\n")
    options = f";secret={secret}" if link == "encrypted" else ""
    total = pace * SECONDS or UNPACED_BYTES
    raw = max(bare_channel("flood", near, far, str(total), str(sdu))["kb_per_s"] for sdu in SDU_BYTES)
    one = Robot(name, near, folder / f"{near}.log")
    two = Robot(f"{name}-far", far, folder / f"{far}.log")
    try:
        one.start([], options)
        figures = {"link up, from the start of a router, s": link_up_s(two, name, options)}
        wait_until(f"linked: {link}", 30, lambda: bool(one.ble_links() and two.ble_links()))
        with one.session() as here, two.session() as there:
            for size in PUT_BYTES:
                before = processor_ms(one)
                messages = min(total // size, MAX_PUTS)
                rate = put_rate(here, there, size, total)
                figures |= {
                    f"goodput, put {size} B, kB/s": rate,
                    f"share of raw, put {size} B": rate / raw,
                    f"processor time of a message of {size} B, ms": (processor_ms(one) - before) / messages,
                }
            figures["round trip, p50, ms"] = statistics.median(query_times_ms(here, there))
            with Urgent(here, there) as urgent:
                started = time.monotonic()
                bulk(here, there, [total], lambda: time.monotonic() - started > BULK_LIMIT_S)
        ages_ms = [age * 1000 for age in urgent.ages_s]
        lost = urgent.sent - len(ages_ms)
        if lost:
            raise SystemExit(f"encryption: {lost} urgent messages were lost ({link})")
        figures |= {f"urgent, p{share}, ms": percentile(ages_ms, share / 100) for share in (50, 99)}
        figures["private memory of a router, MB"] = own_kb(one.pid()) / 1000
    finally:
        one.stop()
        two.stop()
    return figures


def link_up_s(dialing: Robot, peer: str, options: str) -> float:
    """Starts the robot, and returns the time until it is linked."""
    log = f"ble: linked with {peer}"
    dialing.start([f"ble/{peer}"], options, wait=False)
    started = time.monotonic()
    while log not in dialing.log():
        if time.monotonic() - started > 30:
            raise SystemExit(f"encryption: no link with {peer}")
        time.sleep(0.01)
    return time.monotonic() - started


def processor_ms(robot: Robot) -> float:
    """Returns the processor time of a router's threads. /proc/PID/stat is only a sample at each tick of the kernel."""
    threads = Path(f"/proc/{robot.pid()}/task").glob("*/schedstat")
    return sum(int(thread.read_text().split()[0]) for thread in threads) / 1e6


def query_times_ms(here: zenoh.Session, there: zenoh.Session) -> list[float]:
    key = "rect/wombat-2/bench"
    service = there.declare_queryable(key, lambda query: query.reply(key, PAYLOAD))
    querier = here.declare_querier(key, timeout=5)
    times = ask(querier, PAYLOAD, QUERIES)
    service.undeclare()
    return times
