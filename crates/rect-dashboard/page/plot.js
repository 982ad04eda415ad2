// A live plot of the numbers in the values of a topic.

import { eachFrame, h, setText } from "./dom.js";
import { number, timeOfDay, visible } from "./format.js";

/** The largest number of values that are kept. */
const MAX_POINTS = 20_000;
/** The largest number of series, and of those that are shown at first. */
const MAX_SERIES = 24;
const SHOWN_AT_FIRST = 4;
const MAX_DEPTH = 4;
const HEIGHT_PX = 240;
const WINDOWS_S = { "10 s": 10, "1 min": 60, "5 min": 300, everything: Number.POSITIVE_INFINITY };
/** Okabe and Ito's colours, which colour-blind people can tell apart, for both themes; and dashes for more series. */
const COLOURS = ["--series-1", "--series-2", "--series-3", "--series-4", "--series-5", "--series-6"];

/** A plot, as `element`. It is hidden until there are numbers. */
export class Plot {
  element = h("div", { class: "plot", hidden: true });
  #name;
  #times = [];
  #series = new Map();
  #chart = null;
  #canvas = h("div", { class: "chart" });
  #legend = h("div", { class: "legend", role: "group", "aria-label": "Series" });
  #pause = h("button", { click: () => this.#setPaused(!this.#isPaused) }, "Pause");
  #window = h("select", { "aria-label": "Time shown", change: () => this.draw() });
  #isPaused = false;
  #sizes = new ResizeObserver(() => this.#resize());
  #theme = matchMedia("(prefers-color-scheme: dark)");
  #onTheme = () => this.#rebuild();
  #draw = eachFrame(() => this.#drawNow());

  constructor(name) {
    this.#name = name;
    this.#window.append(...Object.keys(WINDOWS_S).map((text) => h("option", { value: text }, text)));
    this.#window.value = "1 min";
    const tools = h(
      "div",
      { class: "row" },
      this.#pause,
      this.#window,
      h("button", { click: () => this.#export() }, "Save as CSV"),
      h("span", { class: "about" }, "Drag to zoom, double-click to zoom out."),
    );
    this.element.append(tools, this.#canvas, this.#legend);
    this.#sizes.observe(this.element);
    this.#theme.addEventListener("change", this.#onTheme);
  }

  /** Adds the numbers of a value that arrived at `time`, in seconds since 1970. */
  add(time, value) {
    const found = new Map();
    collect(value, "", 0, found);
    if (found.size === 0 && this.#series.size === 0) {
      return;
    }
    const isNew = [...found.keys()].filter((name) => !this.#series.has(name));
    for (const name of isNew.slice(0, MAX_SERIES - this.#series.size)) {
      this.#series.set(name, {
        values: this.#times.map(() => null),
        isShown: this.#series.size < SHOWN_AT_FIRST,
      });
    }
    this.#times.push(time);
    for (const [name, series] of this.#series) {
      series.values.push(found.get(name) ?? null);
    }
    // Not one by one, which would move all of them each time.
    if (this.#times.length > MAX_POINTS * 1.1) {
      const many = this.#times.length - MAX_POINTS;
      this.#times.splice(0, many);
      for (const series of this.#series.values()) {
        series.values.splice(0, many);
      }
    }
    if (isNew.length > 0) {
      this.element.hidden = false;
      this.#rebuild();
    }
  }

  /** Draws what has been added, in the next frame. */
  draw() {
    this.#draw();
  }

  close() {
    this.#chart?.destroy();
    this.#chart = null;
    this.#sizes.disconnect();
    this.#theme.removeEventListener("change", this.#onTheme);
  }

  #shown() {
    return [...this.#series].filter(([, series]) => series.isShown);
  }

  #drawNow() {
    if (!this.#chart || this.#isPaused) {
      return;
    }
    const window = WINDOWS_S[this.#window.value];
    const newest = this.#times.at(-1);
    let first = 0;
    if (Number.isFinite(window)) {
      first = this.#times.findIndex((time) => time >= newest - window);
    }
    this.#chart.setData([this.#times.slice(first), ...this.#shown().map(([, { values }]) => values.slice(first))]);
  }

  #setPaused(isPaused) {
    this.#isPaused = isPaused;
    setText(this.#pause, isPaused ? "Continue" : "Pause");
    this.draw();
  }

  #rebuild() {
    this.#chart?.destroy();
    this.#chart = null;
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name).trim();
    const axis = { stroke: colour("--text"), grid: { stroke: colour("--line"), width: 1 }, ticks: { show: false } };
    const series = this.#shown().map(([name], index) => ({
      label: visible(name, 40),
      stroke: colour(COLOURS[index % COLOURS.length]),
      dash: index < COLOURS.length ? undefined : [6, 4],
      width: 2,
      points: { show: false },
      spanGaps: true,
    }));
    this.#chart = new window.uPlot(
      {
        width: this.#width(),
        height: HEIGHT_PX,
        legend: { show: false },
        scales: { x: { time: true } },
        axes: [
          { ...axis, space: 90, values: (_, ticks) => ticks.map((time) => timeOfDay(1000 * time)) },
          { ...axis, size: 60, values: (_, ticks) => ticks.map(number) },
        ],
        series: [{}, ...series],
      },
      [[], ...series.map(() => [])],
      this.#canvas,
    );
    this.#showLegend(series);
    this.#drawNow();
  }

  #showLegend(series) {
    let index = 0;
    const boxes = [...this.#series].map(([name, one]) => {
      const box = h("input", {
        type: "checkbox",
        checked: one.isShown,
        change: () => {
          one.isShown = box.checked;
          this.#rebuild();
        },
      });
      const swatch = h("span", { class: "swatch" });
      if (one.isShown) {
        swatch.style.background = series[index++].stroke;
      }
      return h("label", {}, box, swatch, visible(name || "value", 60));
    });
    this.#legend.replaceChildren(...boxes);
  }

  #width() {
    return Math.max(200, this.element.clientWidth);
  }

  #resize() {
    this.#chart?.setSize({ width: this.#width(), height: HEIGHT_PX });
  }

  #export() {
    const all = [...this.#series];
    const lines = [["time_s", ...all.map(([name]) => quoted(name || "value"))].join(",")];
    for (const [index, time] of this.#times.entries()) {
      lines.push([time.toFixed(3), ...all.map(([, { values }]) => values[index] ?? "")].join(","));
    }
    const url = URL.createObjectURL(new Blob([`${lines.join("\n")}\n`], { type: "text/csv" }));
    h("a", { href: url, download: `${this.#name.replaceAll(/[^\w.-]+/g, "-")}.csv` }).click();
    URL.revokeObjectURL(url);
  }
}

function quoted(text) {
  return `"${text.replaceAll('"', '""')}"`;
}

/** Collects the numbers of a value by their paths, such as `at.x`. */
function collect(value, path, depth, found) {
  if (found.size >= MAX_SERIES) {
    return;
  }
  if (typeof value === "number" || typeof value === "boolean") {
    found.set(path, Number(value));
  } else if (value !== null && typeof value === "object" && depth < MAX_DEPTH) {
    for (const [name, child] of Object.entries(value)) {
      collect(child, path === "" ? name : `${path}.${name}`, depth + 1, found);
    }
  }
}
