"""Draws the figures of the report from stored results.

They can be read without colours: lines differ by dashes and markers, and bars by hatches."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("svg")
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from report.results import Results, number, read, share

ROOT = Path(__file__).resolve().parents[2]
SIMULATED = ROOT / "surveys" / "simulated-air.json"
COLOURS = ["#0b3c8c", "#e07b1a", "#b9d8b0", "#a04668", "#555555", "#1a1a1a"]
MARKERS = ["o", "s", "^", "D", "v", "P"]
DASHES = ["-", "--", "-.", ":", (0, (3, 1, 1, 1, 1, 1)), (0, (1, 3))]
HATCHES = ["", "////", "", "xxxx", "----", "++++"]

matplotlib.rcParams.update(
    {
        "svg.fonttype": "none",
        "svg.hashsalt": "rect",
        "font.family": "sans-serif",
        "font.size": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.axisbelow": True,
        "axes.grid": True,
        "grid.alpha": 0.3,
        "hatch.linewidth": 0.6,
        "legend.frameon": False,
    }
)


@dataclass(frozen=True)
class Drawing:
    """A figure, and the benches whose results it shows."""

    draw: Callable[[], Figure]
    benches: tuple[str, ...]


def panels(count: int, height: float = 2.6, rows: int = 1) -> tuple[Figure, list[Axes]]:
    figure, axes = pyplot.subplots(rows, count // rows, figsize=(7.6, height), squeeze=False)
    figure.set_layout_engine("constrained")
    return figure, list(axes.flat)


def logarithmic(axis: Axis) -> None:
    """Gives an axis a logarithmic scale with numbers such as 200."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:,g}")
    axis.set_minor_formatter(NullFormatter())


def line(axes: Axes, at: int, x: list[float], y: list[float], label: str) -> None:
    axes.plot(
        x, y, color=COLOURS[at], linestyle=DASHES[at], marker=MARKERS[at], markersize=4, linewidth=1.5, label=label
    )


def bars(axes: Axes, groups: list[str], series: dict[str, list[float]], unit: str, digits: int = 0) -> None:
    """Draws a group of bars for each of `groups`, with a bar for each of `series` and its value."""
    width = 0.8 / len(series)
    for at, (name, values) in enumerate(series.items()):
        places = [group - 0.4 + width * (at + 0.5) for group in range(len(groups))]
        drawn = axes.bar(
            places, values, width, label=name, color=COLOURS[at], hatch=HATCHES[at], edgecolor="white", linewidth=0.5
        )
        labels = ["" if math.isnan(value) else f"{value:,.{digits if value else 0}f}" for value in values]
        axes.bar_label(drawn, labels, fontsize=7, padding=1)
    axes.set_xticks(range(len(groups)), groups)
    axes.set_ylabel(unit)
    axes.grid(visible=False, axis="x")


def grouped(
    rows: list[dict[str, str]], column: str, value: Callable[[dict[str, str]], float]
) -> dict[str, list[float]]:
    """Returns the values of the rows, by the text in a column."""
    names = dict.fromkeys(row[column] for row in rows)
    return {name: [value(row) for row in rows if row[column] == name] for name in names}


def legend(figure: Figure, axes: Axes, columns: int = 3) -> None:
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=columns, fontsize=8)


def goodput() -> Figure:
    rows = [row for row in read("goodput").rows if row["pace"] != "none"]
    sizes = [column for column in rows[0] if column.startswith("put ")]
    figure, axes = panels(len(rows))
    for panel, row in zip(axes, rows, strict=True):
        raw = number(row["raw, best SDU"])
        line(
            panel, 0, [number(size) for size in sizes], [number(row[size]) for size in sizes], "Zenoh over RECT's link"
        )
        panel.axhline(raw, color=COLOURS[1], linestyle="--", label="bare L2CAP channel")
        panel.set(xscale="log", ylim=(0, raw * 1.15), title=row["pace"], xlabel="bytes of a message", ylabel="kB/s")
    legend(figure, axes[0])
    return figure


def radio() -> Figure:
    rows = read("radio").rows
    sizes = [column for column in rows[0] if column.startswith("put ")]
    figure, (panel,) = panels(1, 3.2)
    for at, row in enumerate(rows):
        line(panel, at, [number(size) for size in sizes], [number(row[size]) for size in sizes], row["radio"])
        panel.axhline(number(row["bare channel"]), color=COLOURS[at], linestyle=":", linewidth=1)
    panel.set(xscale="log", yscale="log", xlabel="bytes of a message", ylabel="kB/s (dotted: bare channel)")
    logarithmic(panel.yaxis)
    legend(figure, panel)
    return figure


def latency() -> Figure:
    places = [place for place in json.loads(SIMULATED.read_text())["places"] if place["path"] == "ble"]
    figure, axes = panels(2)
    for at, place in enumerate(places):
        for panel, key in zip(axes, ["round_trip", "round_trip_under_load"], strict=True):
            shares, times_ms = zip(*place[key]["curve"], strict=True)
            line(panel, at, list(times_ms), [100 * one for one in shares], place["label"])
    for panel, title in zip(axes, ["nothing else on the link", "beside a load"], strict=True):
        panel.set(title=title, xlabel="round trip (ms)", ylabel="% of the requests", xlim=(0, None), ylim=(0, 103))
        for drawn in panel.lines:
            drawn.set_markersize(2.5)
    legend(figure, axes[0])
    return figure


def conditions() -> Figure:
    rows = read("conditions").rows
    names = list(dict.fromkeys(row["condition"] for row in rows))
    lost = {row["condition"]: row["packets lost"] for row in rows}
    groups = [f"{name.replace('-', chr(10), 1).replace('-', ' ')}\n{lost[name]}" for name in names]

    figure, axes = panels(2, 3)
    bars(axes[0], groups, grouped(rows, "peer", lambda row: number(row["messages lost"])), "% of the messages lost")
    bars(axes[1], groups, grouped(rows, "peer", lambda row: number(row["p99"])), "age, p99 (ms)")
    axes[1].set_yscale("log")
    logarithmic(axes[1].yaxis)
    for panel in axes:
        panel.tick_params(axis="x", labelsize=7)
        panel.set_xlabel("radio condition, share of packets lost")
    legend(figure, axes[0])
    return figure


def buffering() -> Figure:
    rows = read("buffering").rows
    peers = list(dict.fromkeys(row["peer"] for row in rows))
    figure, axes = panels(len(peers))
    for panel, peer in zip(axes, peers, strict=True):
        of_peer = [row for row in rows if row["peer"] == peer]
        groups = [f"{row['queue']}\n{row['dropped']}" for row in of_peer]
        ages = {column: [number(row[column]) for row in of_peer] for column in ["age p50", "p99"]}
        bars(panel, groups, ages, "age on arrival (ms)")
        panel.set(title=peer, xlabel="queue, share of messages dropped", yscale="log", ylim=(100, 20_000))
        logarithmic(panel.yaxis)
        panel.tick_params(axis="x", labelsize=7)
    legend(figure, axes[0])
    return figure


def failover() -> Figure:
    rows = read("failover").rows
    peers = list(dict.fromkeys(row["peer"] for row in rows))
    figure, axes = panels(2, 3)
    groups = [peer.replace(", ", ",\n").replace(": ", ":\n").replace(" alone", "\nalone") for peer in peers]
    bars(axes[0], groups, grouped(rows, "Wi-Fi", lambda row: number(row["small p99"])), "age of a message, p99 (ms)")
    axes[0].set_yscale("log")
    logarithmic(axes[0].yaxis)
    bars(axes[1], groups, grouped(rows, "Wi-Fi", lambda row: 100 * share(row["small lost"])), "% of the messages lost")
    for panel in axes:
        panel.tick_params(axis="x", labelsize=6)
    legend(figure, axes[0])
    return figure


def video() -> Figure:
    rows = [row for row in read("stream").rows if row["picture"] == "640x480" and row["link"] == "34 kB/s"]
    senders = [row["sender"].replace(", ", ",\n") for row in rows]
    figure, axes = panels(3)
    for panel, column, unit, digits in zip(
        axes, ["frames/s", "SSIM", "p99"], ["frames per second", "SSIM", "age, p99 (ms)"], [1, 2, 0], strict=True
    ):
        bars(panel, senders, {column: [number(row[column]) for row in rows]}, unit, digits)
        panel.tick_params(axis="x", labelsize=7)
    return figure


def compression() -> Figure:
    rows = read("codecs").rows
    formats = ["JSON", "CBOR", "zstd 3", "zstd, dictionary"]
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    by = {(row["kind"], row["format"]): row for row in rows}
    figure, axes = panels(2)
    bars(
        axes[0],
        kinds,
        {one: [number(by[kind, one]["bytes"]) for kind in kinds] for one in formats},
        "bytes of a message",
    )

    def both_us(kind: str, one: str) -> float:
        return number(by[kind, one]["encode"]) + number(by[kind, one]["decode"])

    bars(axes[1], kinds, {one: [both_us(kind, one) for kind in kinds] for one in formats}, "us to encode and decode", 1)
    legend(figure, axes[0], 4)
    return figure


def middleware() -> Figure:
    rows = [row for row in read("middleware").rows if row["payload, what"].startswith("64 B: ")]
    names = [row["payload, what"].removeprefix("64 B: ") for row in rows]
    names = [name.replace(", ", ",\n").replace(" over ", "\nover ") for name in names]
    figure, axes = panels(2, 4.6, rows=2)
    latencies = {
        "publish": [number(row["publish p50"]) for row in rows],
        "request": [number(row["request p50"]) for row in rows],
    }
    bars(axes[0], names, latencies, "p50 (us)")
    thousands = [number(row["messages/s"]) / 1000 for row in rows]
    bars(axes[1], names, {"messages": thousands}, "thousand messages per second")
    for panel in axes:
        panel.tick_params(axis="x", labelsize=6)
    legend(figure, axes[0])
    return figure


def registry() -> Figure:
    rows = [row for row in read("registry").rows if "of a robot" in row["what"]]
    groups = [
        row["what"].replace("`", "").replace(" of a robot with ", "\n").replace(" connections", " links")
        for row in rows
    ]
    series = {"p50": [number(row["p50"]) for row in rows], "p99": [number(row["p99 or max"]) for row in rows]}
    figure, (panel,) = panels(1, 2.4)
    bars(panel, groups, series, "ms until the answer", 1)
    legend(figure, panel)
    return figure


def memory() -> Figure:
    rows = read("idle").rows
    columns = ["private memory", "resident memory (RSS)", "size, stripped"]
    figure, (panel,) = panels(1, 2.4)
    bars(panel, columns, {row["program"]: [number(row[column]) for column in columns] for row in rows}, "MB", 1)
    legend(figure, panel)
    return figure


def encryption() -> Figure:
    rows = [row for row in read("encryption").rows if row["pace"] != "none"]
    paces = list(dict.fromkeys(row["pace"] for row in rows))
    links = ["encrypted", "not encrypted"]

    def of(what: str, factor: float = 1) -> dict[str, list[float]]:
        return {link: [factor * number(row[link]) for row in rows if row["what"].startswith(what)] for link in links}

    figure, axes = panels(3)
    bars(axes[0], paces, of("share of raw, put 16000 B", 100), "% of a bare channel", 1)
    bars(axes[1], paces, of("round trip, p50"), "round trip, p50 (ms)", 1)
    bars(axes[2], paces, of("urgent, p99"), "urgent messages, p99 (ms)")
    legend(figure, axes[0])
    return figure


def transfer() -> Figure:
    rows = read("transfer").rows
    figure, (panel,) = panels(1, 2.6)
    rates = {row["link"]: row["link"].split(" (")[0] for row in rows}
    cases = [case.replace(" and three", "\nand three") for case in dict.fromkeys(row["case"] for row in rows)]
    of_raw = grouped(rows, "link", lambda row: 100 * number(row["kB/s (of raw)"].split("(")[1]))
    bars(panel, cases, {rates[link]: shares for link, shares in of_raw.items()}, "% of a bare channel")
    legend(figure, panel)
    return figure


def isolation() -> Figure:
    rows = read("isolation").rows
    groups = [
        row["router"].replace(", ", ",\n").replace("router without", "router\nwithout").replace("`", "") for row in rows
    ]
    columns = [column for column in rows[0] if column.startswith(("bytes", "while", "when"))]
    figure, axes = panels(2, 2.8)
    air = [sum(number(row[column]) for column in columns) for row in rows]
    bars(axes[0], groups, {"": air}, "kB on the air for other fleets", 1)
    bars(
        axes[1], groups, {"": [number(row["growth of a robot's router"]) for row in rows]}, "MB in a robot's router", 1
    )
    for panel in axes:
        panel.tick_params(axis="x", labelsize=7)
    return figure


def churn() -> Figure:
    figure, (panel,) = panels(1, 2.8)
    # The third colour is too light for a line.
    for at, row in zip((0, 1, 3), reversed(read("churn").rows), strict=True):
        sizes = {number(column): number(cell) for column, cell in row.items() if column.endswith("times")}
        line(panel, at, list(sizes), list(sizes.values()), row["router, link"])
    panel.set(xlabel="times that the neighbour was killed", ylabel="private memory (MB)", ylim=(0, None))
    legend(figure, panel)
    return figure


#: The figures, by the name of their file.
DRAWINGS = {
    "goodput": Drawing(goodput, ("goodput",)),
    "radio": Drawing(radio, ("radio",)),
    "latency": Drawing(latency, ()),
    "conditions": Drawing(conditions, ("conditions",)),
    "buffering": Drawing(buffering, ("buffering",)),
    "failover": Drawing(failover, ("failover",)),
    "encryption": Drawing(encryption, ("encryption",)),
    "video": Drawing(video, ("stream",)),
    "transfer": Drawing(transfer, ("transfer",)),
    "compression": Drawing(compression, ("codecs",)),
    "middleware": Drawing(middleware, ("middleware",)),
    "registry": Drawing(registry, ("registry",)),
    "memory": Drawing(memory, ("idle",)),
    "churn": Drawing(churn, ("churn",)),
    "isolation": Drawing(isolation, ("isolation",)),
}


def results() -> list[Results]:
    """Returns the results that the figures show."""
    names = {bench: None for drawing in DRAWINGS.values() for bench in drawing.benches}
    return [read(name) for name in names]
