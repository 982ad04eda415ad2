// Actions and their goals: what the catalogue and the states of goals say about them, in words.

import { seconds, timeOfDay, visible } from "./format.js";

const TOPIC = "@rect/@set/actions/";
const DAY_MS = 24 * 3600 * 1000;
const OPEN = new Set(["waiting", "running", "cancelling"]);
const PHASES = {
  waiting: "waits for the end of another goal",
  running: "is carried out",
  cancelling: "is asked to end",
  done: "done",
  refused: "refused",
  failed: "failed",
  cancelled: "cancelled",
  preempted: "preempted",
  lost: "lost: its program has ended",
};
const CONDITIONS = { done: "good", failed: "bad", lost: "bad" };

/** Returns the action that is served at an internal topic; `null` for the topic of an ordinary service. */
export function actionOf(topic) {
  return topic.startsWith(TOPIC) ? topic.slice(TOPIC.length) : null;
}

/** Returns whether a goal has not ended. */
export function isOpen({ phase }) {
  return OPEN.has(phase);
}

/** Returns how far a goal has come, with the reason. */
export function phaseText({ phase, reason }) {
  const text = PHASES[phase] ?? phase;
  // The text of a goal that is lost is the reason already.
  if (reason === "" || phase === "lost") {
    return text;
  }
  // Such as: cancelled by wombat-1.
  return `${text}${reason.startsWith("by ") ? "" : ":"} ${visible(reason, 400)}`;
}

/** Returns whether that is good or bad; empty for the rest. */
export function condition({ phase }) {
  return CONDITIONS[phase] ?? "";
}

/** Returns since when it is so, and by whom the goal was started. */
export function sinceText(goal, nowMs) {
  const { since_ms: since, by } = goal;
  const day = Math.abs(nowMs - since) < DAY_MS / 2 ? "" : `${new Date(since).toLocaleDateString()} `;
  const time = `${day}${timeOfDay(since)}`;
  const started = by === "" ? "" : `, started by ${visible(by, 100)}`;
  return isOpen(goal) ? `for ${age(nowMs - since)}${started}` : `at ${time}${started}`;
}

function age(ms) {
  return ms < 10_000 ? `${Math.max(0, Math.round(ms / 1000))} s` : seconds(ms / 1000);
}
