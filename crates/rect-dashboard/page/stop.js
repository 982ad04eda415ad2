// The Stop button: stops the fleet. Every page shows who has stopped it and how far each robot has followed, until somebody releases it.

import { h, setText, updateList } from "./dom.js";
import { milliseconds, timeOfDay, visible } from "./format.js";

const TITLE = "Stops the robots whose programs take part in the stop of the fleet";
const NOTHING_MOVES = "At the release nothing moves: each robot waits for a neutral command first.";
const DAY_MS = 24 * 3600 * 1000;
const MARKS = { confirmed: "✓", waiting: "…", no_part: "-" };
const TEXTS = {
  confirmed: "has confirmed",
  waiting: "has not confirmed yet",
  silent: "has not confirmed",
  ended: "has not confirmed: its program has ended",
  no_part: "takes no part in stops: no program of it listens",
  unreachable: "cannot be reached. It stops when it returns, if it takes part",
};

/** Returns the button, and the area that shows the stop. */
export function stopButton(link) {
  const button = h("button", { class: "stop", title: TITLE, click: press }, "STOP");
  const headline = h("strong");
  const problem = h("p", { class: "error" });
  const stops = h("ul", { class: "stops" });
  const robots = h("ul", { class: "followers" });
  const release = h("button", { click: () => ask(true) }, "Release…");
  const confirm = h("button", { class: "danger", click: send }, "Release the stop");
  const keep = h("button", { click: () => ask(false) }, "Keep it");
  const question = h("div", { class: "row", role: "group", "aria-label": "Release the stop?" });
  question.append(h("span", {}, NOTHING_MOVES), confirm, keep);
  const refused = h("p", { class: "about" }, "This page may not release it.");
  const alert = h("div", { role: "alert" }, headline, problem);
  const details = h("details", { open: true }, h("summary", {}, "Each robot"), stops, robots);
  const area = h("section", { class: "stop-area", "aria-label": "Stop" }, alert, details, release, question, refused);
  /** Why the last command has failed. */
  let failure = "";
  let isAsking = false;

  async function press() {
    const isOpen = link.condition === "open";
    failure = "";
    try {
      await link.command("stop");
    } catch (error) {
      // While the fleet is stopped, the state says why it was not sent.
      failure = link.states.stop?.stop && isOpen ? "" : `Not sent: ${error.message}.`;
    }
    show();
  }

  async function send() {
    ask(false);
    try {
      await link.command("release_stop");
      failure = "";
    } catch (error) {
      failure = `Not released: ${error.message}`;
    }
    show();
  }

  function ask(isAsked) {
    isAsking = isAsked;
    show();
    (isAsked ? confirm : release).focus();
  }

  function show() {
    const stop = link.states.stop?.stop ?? null;
    const mayRelease = link.states.hello?.read_only === false;
    isAsking &&= stop !== null && mayRelease;
    area.hidden = stop === null && failure === "";
    area.dataset.state = stop === null ? "failed" : "stopped";
    details.hidden = stop === null;
    release.hidden = stop === null || isAsking || !mayRelease;
    question.hidden = stop === null || !isAsking;
    refused.hidden = stop === null || mayRelease;
    setText(headline, stop === null ? "" : headlineText(stop));
    setText(problem, [failure, visible(stop?.problem ?? "", 400)].filter(Boolean).join(" "));
    if (stop === null) {
      return;
    }
    updateList(
      stops,
      stop.pressed,
      ({ by, at_ms: at, reason }) => [by, at, reason].join("\n"),
      () => h("li"),
      (line, pressed) => setText(line, pressedText(pressed)),
    );
    updateList(
      robots,
      stop.robots,
      ({ robot }) => robot,
      () => h("li"),
      (line, robot) => {
        line.className = { confirmed: "", waiting: "", no_part: "warn" }[robot.outcome] ?? "error";
        setText(line, robotText(robot));
      },
    );
  }

  for (const event of ["stop", "hello"]) {
    link.addEventListener(event, show);
  }
  show();
  return { button, area };
}

function headlineText({ is_sent: isSent, robots }) {
  const parts = robots.filter(({ outcome }) => outcome !== "no_part");
  const confirmed = parts.filter(({ outcome }) => outcome === "confirmed");
  if (!isSent && confirmed.length === 0) {
    return "Stop: not sent yet";
  }
  return parts.length === 0
    ? "The fleet is stopped, but no other robot takes part"
    : `The fleet is stopped: confirmed by ${confirmed.length} of ${parts.length}`;
}

function pressedText({ by, reason, at_ms: at }) {
  const day = Math.abs(Date.now() - at) < DAY_MS / 2 ? "" : `${new Date(at).toLocaleDateString()} `;
  const why = reason === "" ? "" : `: ${visible(reason, 100)}`;
  return `since ${day}${timeOfDay(at)} by ${visible(by, 100)}${why}`;
}

function robotText({ robot, outcome, ms }) {
  const after = ms === null ? "" : ` after ${milliseconds(ms)}`;
  return `${MARKS[outcome] ?? "✗"} ${visible(robot, 60)} ${TEXTS[outcome]}${after}`;
}
