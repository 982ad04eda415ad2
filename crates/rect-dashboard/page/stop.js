// The Stop button: asks all robots to stop, and shows which ones have confirmed it.

import { h } from "./dom.js";
import { milliseconds } from "./format.js";

/** Returns the button, which sends a request to the service `stop` of all robots. */
export function stopButton(link, stop) {
  const result = h("div", { class: "stop-result", role: "alert" });
  const title = `Sends an urgent request to the service ${stop} of all robots`;
  const button = h("button", { class: "stop", title, click: press }, "STOP");

  async function press() {
    result.replaceChildren(h("p", {}, "Stop sent…"));
    try {
      show(await link.command("stop"));
    } catch (error) {
      result.replaceChildren(h("p", { class: "error" }, `The stop has failed: ${error.message}`), dismiss());
    }
  }

  function show({ confirmed, reachable, problems }) {
    const names = confirmed.map(({ robot }) => robot);
    const missing = reachable.filter((robot) => !names.includes(robot));
    const lines = confirmed.map(({ robot, ms }) => h("li", {}, `✓ ${robot} stopped after ${milliseconds(ms)}`));
    lines.push(...missing.map((robot) => h("li", { class: "error" }, `✗ ${robot} has not confirmed`)));
    lines.push(...problems.map((problem) => h("li", { class: "error" }, problem)));
    const summary = confirmed.length === 0 ? "No robot has confirmed the stop" : `${confirmed.length} confirmed`;
    result.replaceChildren(h("strong", {}, summary), h("ul", {}, lines), dismiss());
  }

  function dismiss() {
    return h("button", { click: () => result.replaceChildren() }, "Close");
  }

  return h("div", { class: "stop-area" }, button, result);
}
