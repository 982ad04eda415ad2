"""Plots the ages of urgent messages: a panel for each link and case, a line for each peer."""

from pathlib import Path

import matplotlib

matplotlib.use("svg")
from matplotlib import pyplot

matplotlib.rcParams["svg.fonttype"] = "none"

PATH = Path(__file__).parent / "results" / "urgent.svg"
POINTS = 50
COLOURS = ["tab:blue", "tab:orange", "tab:green"]


def plot(rows: list[tuple]) -> None:
    """Writes the plot of `rows` (link, case, peer, outcome). A line ends below 1 if messages were lost."""
    rows = [row for row in rows if row[3].sent]
    links, cases, peers = (list(dict.fromkeys(row[n] for row in rows)) for n in range(3))
    size = (3 * len(cases), 2.8 * len(links))
    figure, panels = pyplot.subplots(len(links), len(cases), sharex=True, sharey=True, squeeze=False, figsize=size)
    for link, case, peer, outcome in rows:
        panel = panels[links.index(link)][cases.index(case)]
        ages_ms = sorted(age * 1000 for age in outcome.ages_s)
        shares = [(n + 1) / outcome.sent for n in range(len(ages_ms))]
        # The file stays small with few points, which include the first and the last one.
        shown = [*range(0, len(ages_ms), max(1, len(ages_ms) // POINTS)), len(ages_ms) - 1] if ages_ms else []
        panel.step(
            [ages_ms[n] for n in shown],
            [shares[n] for n in shown],
            where="post",
            color=COLOURS[peers.index(peer)],
            label=peer,
        )
        panel.set_title(f"{case}\n{link}", fontsize=9)
    for panel in panels.flat:
        panel.set_xscale("log")
        panel.set_ylim(0, 1.02)
        panel.grid(alpha=0.3)
    for panel in panels[-1]:
        panel.set_xlabel("age on arrival (ms)")
    for row in panels:
        row[0].set_ylabel("share of those sent")
    figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=len(peers))
    figure.set_layout_engine("constrained")
    PATH.parent.mkdir(exist_ok=True)
    figure.savefig(PATH, metadata={"Date": None})
