// The view of events: robots, links and errors, with their times.

import { eachFrame, h, setText, table, updateList, wordFilter } from "./dom.js";
import { timeOfDay, visible } from "./format.js";

const TEXTS = {
  peer_up: "robot reachable",
  peer_down: "robot not reachable",
  program_up: "program began",
  program_down: "program ended",
  link_up: "link established",
  link_down: "link ended",
  link_silent: "link silent",
  link_resumed: "link resumed",
  path_switched: "path switched",
  router_up: "router connected",
  router_down: "router lost",
  error: "error",
};
const BAD = ["peer_down", "program_down", "link_down", "router_down", "error"];

/** Shows the events in `parent`, until the returned function is called. */
export function events(link, parent) {
  const filter = h("input", {
    type: "search",
    placeholder: "Filter",
    "aria-label": "Filter events",
    input: () => show(),
  });
  const errors = h("input", { type: "checkbox", change: () => show() });
  const lines = table("Events", ["Time", "What", "Robot", "By", "Details"]);
  const empty = h("p", { class: "empty" });
  parent.append(
    h("h1", {}, "Events"),
    h("div", { class: "row" }, filter, h("label", { class: "check" }, errors, "only losses and errors")),
    empty,
    lines.element,
  );
  const show = eachFrame(() => {
    const matches = wordFilter(filter);
    const all = link.states.events?.events ?? [];
    const shown = all.filter((event) => {
      const text = `${textOf(event)} ${event.of} ${event.robot} ${event.method} ${event.detail}`;
      return (!errors.checked || BAD.includes(event.kind)) && matches(text);
    });
    setText(
      empty,
      shown.length > 0 ? "" : all.length > 0 ? "No event matches the filter." : "Nothing has happened yet.",
    );
    empty.hidden = shown.length > 0;
    lines.element.hidden = shown.length === 0;
    updateList(lines.body, shown.toReversed(), keyOf, row, () => {});
  });
  link.addEventListener("events", show);
  show();
  return () => link.removeEventListener("events", show);
}

function textOf({ kind }) {
  return TEXTS[kind] ?? kind;
}

function keyOf({ at_ms: at, of, kind, robot, method, detail }) {
  return [at, of, kind, robot, method, detail].join("\n");
}

function row(event) {
  const isBad = BAD.includes(event.kind);
  return h(
    "tr",
    { class: isBad ? "bad" : "" },
    h("td", {}, timeOfDay(event.at_ms)),
    h("td", {}, `${isBad ? "✗" : "✓"} ${textOf(event)}`),
    h("td", {}, event.robot === null && event.method !== null ? "a program" : visible(event.robot ?? event.of, 60)),
    h("td", {}, event.method ?? ""),
    h("td", {}, visible(event.detail ?? "", 300)),
  );
}
