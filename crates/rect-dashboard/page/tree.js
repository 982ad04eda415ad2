// Shows a value as a tree of names and values.

import { h } from "./dom.js";
import { number, visible } from "./format.js";

/** The largest number of lines. */
const MAX_LINES = 400;
/** The depth to which a tree is open at first. */
const OPEN_DEPTH = 2;

/** Returns an element, and `show(value)`, which makes it show a value. */
export function valueTree() {
  const element = h("div", { class: "tree" });
  /** The parts that the user has opened or closed. */
  const chosen = new Map();
  let shown = null;

  function show(value) {
    const text = JSON.stringify(value);
    if (text === shown) {
      return;
    }
    shown = text;
    const budget = { lines: MAX_LINES };
    // A part that was chosen by keyboard stays so.
    const focused = element.contains(document.activeElement) ? document.activeElement.dataset.path : undefined;
    element.replaceChildren(build("", value, "", 0, budget));
    if (focused !== undefined) {
      const parts = [...element.querySelectorAll("summary")];
      parts.find((part) => part.dataset.path === focused)?.focus({ preventScroll: true });
    }
    if (budget.lines <= 0) {
      element.append(h("p", { class: "about" }, `The first ${MAX_LINES} lines are shown.`));
    }
  }

  function build(name, value, path, depth, budget) {
    budget.lines -= 1;
    const label = name === "" ? [] : [h("span", { class: "key" }, `${visible(name, 80)}: `)];
    if (value === null || typeof value !== "object") {
      return h("div", { class: "leaf" }, label, leaf(value));
    }
    const entries = Object.entries(value);
    const about = Array.isArray(value) ? `${entries.length} items` : `${entries.length} fields`;
    const isOpen = chosen.get(path) ?? (depth < OPEN_DEPTH && entries.length <= 100);
    const details = h(
      "details",
      { open: isOpen },
      h("summary", { "data-path": path }, label, h("span", { class: "about" }, about)),
    );
    details.addEventListener("toggle", () => {
      if (details.open !== isOpen) {
        chosen.set(path, details.open);
        shown = null;
      }
    });
    if (isOpen) {
      for (const [key, child] of entries) {
        if (budget.lines <= 0) {
          break;
        }
        details.append(build(key, child, `${path}\n${key}`, depth + 1, budget));
      }
    } else {
      // Filled when it is opened, by the next value or at once.
      details.addEventListener("toggle", () => details.open && fill(details, entries, path, depth), { once: true });
    }
    return details;
  }

  function fill(details, entries, path, depth) {
    const budget = { lines: MAX_LINES };
    if (details.childElementCount === 1) {
      details.append(
        ...entries.slice(0, MAX_LINES).map(([key, child]) => build(key, child, `${path}\n${key}`, depth + 1, budget)),
      );
    }
  }

  return { element, show };
}

function leaf(value) {
  const text =
    typeof value === "number" ? number(value) : typeof value === "string" ? visible(value, 2000) : String(value);
  return h("span", { class: `value ${typeof value}` }, text);
}
