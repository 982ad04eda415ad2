// The Stop button: asks all robots to stop. Every page shows which ones have confirmed it, until somebody clears it.

import { h, setText, updateList } from "./dom.js";
import { milliseconds, timeOfDay, visible } from "./format.js";

/** Returns the button, which sends a request to the service `stop` of all robots. */
export function stopButton(link, stop) {
  const title = `Sends an urgent request to the service ${stop} of all robots`;
  const button = h("button", { class: "stop", title, click: () => send(false) }, "STOP");
  const summary = h("strong");
  const problem = h("p", { class: "error" });
  const robots = h("ul");
  const again = h("button", { click: () => send(true) }, "Ask again");
  const buttons = h("div", { class: "row" }, again, h("button", { click: clear }, "Clear"));
  const result = h("div", { class: "stop-result", role: "alert" }, summary, problem, robots, buttons);
  /** Why the last command has failed. */
  let failure = "";

  async function send(onlyAgain) {
    const isOpen = link.condition === "open";
    try {
      await link.command("stop", { again: onlyAgain });
      failure = "";
    } catch (error) {
      failure = isOpen ? error.message : `Not sent: ${error.message}.`;
    }
    show();
  }

  async function clear() {
    failure = "";
    show();
    try {
      await link.command("clear_stop");
    } catch (error) {
      failure = error.message;
      show();
    }
  }

  function show() {
    const run = link.states.stop?.run ?? null;
    const all = run?.robots ?? [];
    const asked = all.filter(({ outcome }) => outcome !== "no_service");
    const confirmed = asked.filter(({ outcome }) => outcome === "confirmed");
    result.hidden = run === null && failure === "";
    again.hidden = run === null || confirmed.length === all.length;
    setText(summary, run === null ? "" : summaryText(run, asked.length, confirmed.length));
    const waits = run?.is_open && asked.every(({ outcome }) => outcome !== "waiting");
    const further = waits ? "A further service has not answered yet." : "";
    setText(problem, [failure, visible(run?.problem ?? "", 400), further].filter(Boolean).join(" "));
    updateList(
      robots,
      all,
      ({ robot }) => robot,
      () => h("li"),
      (line, robot) => {
        line.className = { confirmed: "", waiting: "", no_service: "faint" }[robot.outcome] ?? "error";
        setText(line, lineText(robot, stop));
      },
    );
  }

  link.addEventListener("stop", show);
  show();
  return h("div", { class: "stop-area" }, button, result);
}

function summaryText({ at_ms: at, is_sent: isSent }, asked, confirmed) {
  const time = timeOfDay(at);
  if (!isSent) {
    return `Stop of ${time}: not sent`;
  }
  return asked === 0
    ? `Stop of ${time}: no robot provides the service`
    : `Stop of ${time}: ${confirmed} of ${asked} confirmed`;
}

function lineText({ robot, outcome, ms, error }, stop) {
  switch (outcome) {
    case "confirmed":
      return `✓ ${robot} stopped after ${milliseconds(ms)}`;
    case "waiting":
      return `… ${robot} has not confirmed yet`;
    case "failed":
      return `✗ ${robot} replied with an error: ${visible(error, 500)}`;
    case "no_service":
      return `- ${robot} does not provide the service ${stop}`;
    case "unreachable":
      return `✗ ${robot} cannot be reached`;
    default:
      return `✗ ${robot} has not confirmed`;
  }
}
