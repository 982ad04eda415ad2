// The alerts of robots: a list for the view of the fleet, and their count for the header.

import { h, setText, updateList } from "./dom.js";
import { timeOfDay, visible } from "./format.js";

const MARKS = { debug: "·", info: "ℹ", warn: "⚠", error: "✗" };
const DAY_MS = 24 * 3600 * 1000;

/** Returns a list as an element, and `show(alerts)`. `namesRobots`: each line begins with the robot. */
export function alertList(label, namesRobots = false) {
  const list = h("ul", { class: "alerts", "aria-label": label });
  const element = h("div", {}, namesRobots ? h("h2", {}, label) : null, list);
  return {
    element,
    show(alerts) {
      element.hidden = alerts.length === 0;
      updateList(
        list,
        alerts,
        ({ robot, name }) => `${robot}\n${name}`,
        () => h("li", {}, h("strong"), h("span", { class: "about" })),
        (line, alert) => {
          const [what, about] = line.children;
          line.dataset.level = alert.level;
          const robot = namesRobots ? `${visible(alert.robot, 60)}: ` : "";
          setText(what, `${MARKS[alert.level]} ${robot}${visible(alert.text, 500)}`);
          setText(about, ` ${alert.level}, ${aboutText(alert)}`);
        },
      );
    },
  };
}

/** Returns the element that shows how many alerts there are. */
export function alertCount(link) {
  const element = h("a", { class: "alert-count", href: "#fleet", hidden: true });
  // An area that exists before its text changes is announced.
  const area = h("span", { role: "status" }, element);
  link.addEventListener("alerts", () => {
    const { alerts } = link.states.alerts;
    const isError = alerts.some(({ level }) => level === "error");
    element.hidden = alerts.length === 0;
    element.dataset.level = isError ? "error" : "warn";
    setText(element, `${isError ? "✗" : "⚠"} ${alerts.length === 1 ? "1 alert" : `${alerts.length} alerts`}`);
  });
  return area;
}

function aboutText({ since_ms: since, program, has_ended: hasEnded }) {
  const day = Math.abs(Date.now() - since) < DAY_MS / 2 ? "" : `${new Date(since).toLocaleDateString()} `;
  const by = program === "" ? "" : `, by ${visible(program, 60)}`;
  return `since ${day}${timeOfDay(since)}${by}${hasEnded ? "; its program has ended" : ""}`;
}
