// The view of the fleet: a picture of the robots and their links, and a card for each robot.

import { alertList } from "./alerts.js";
import { eachFrame, h, setText, table, updateList } from "./dom.js";
import { bytes, milliseconds, pathText, seconds, visible } from "./format.js";
import { drawMap } from "./map.js";
import { connectionKey, Rates } from "./rates.js";

const LINKS = ["With", "By", "Signal", "Round trip", "Urgent", "Sent", "Received", "Waiting", "Lost", "Since", "State"];

/** Shows the fleet in `parent`, until the returned function is called. */
export function fleet(link, parent) {
  const picture = h("figure", { class: "picture" });
  const cards = h("div", { class: "cards" });
  const others = alertList("Alerts of robots that are not reachable", true);
  const empty = h("p", { class: "empty" });
  parent.append(h("h1", {}, "Fleet"), empty, picture, others.element, cards);
  const rates = new Rates();
  const show = eachFrame(() => {
    const robots = link.states.fleet?.robots ?? [];
    const own = link.states.hello?.robot;
    setText(empty, emptyText(link, robots));
    empty.hidden = empty.textContent === "";
    drawMap(picture, robots, own);
    rates.update(robots);
    const alerts = link.states.alerts?.alerts ?? [];
    const names = new Set(robots.map(({ name }) => name));
    others.show(alerts.filter(({ robot }) => !names.has(robot)));
    updateList(
      cards,
      robots,
      (robot) => robot.name,
      () => card(link),
      (element, robot) => element.show(robot, own, rates, link.states.time?.at_s, alerts),
    );
  });
  for (const event of ["fleet", "alerts"]) {
    link.addEventListener(event, show);
  }
  show();
  return () => {
    for (const event of ["fleet", "alerts"]) {
      link.removeEventListener(event, show);
    }
  };
}

function emptyText(link, robots) {
  if (!link.states.fleet) {
    return link.condition === "open" ? "Asking the routers…" : "Connecting to the dashboard…";
  }
  return robots.filter((robot) => robot.reachable).length > 1
    ? ""
    : "No other robot is in range: is its router running? `rect scan` on this computer shows what its radio receives.";
}

function card(link) {
  const name = h("h2");
  const state = h("span", { class: "badge" });
  const about = h("p", { class: "about" });
  const problems = h("ul", { class: "problems" });
  const alerts = alertList("Alerts");
  const logLink = h("a", { class: "log-link" }, "Log");
  const none = h("p", { class: "about" });
  const links = table("Links", LINKS);
  const checkButton = h("button", { click: check }, "Check");
  const findings = h("ul", { class: "findings" });
  const foot = h("div", { class: "row" }, checkButton, logLink);
  const element = h(
    "section",
    { class: "card" },
    h("header", {}, name, state),
    about,
    alerts.element,
    problems,
    none,
    links.element,
    foot,
    findings,
  );

  async function check() {
    checkButton.disabled = true;
    try {
      const found = await link.command("check", { robot: name.textContent });
      findings.replaceChildren(...found.map(findingItem));
    } catch (error) {
      findings.replaceChildren(h("li", { class: "error" }, visible(error.message, 300)));
    } finally {
      checkButton.disabled = false;
    }
  }

  element.show = (robot, own, rates, now, all) => {
    setText(name, robot.name);
    checkButton.hidden = !robot.reachable;
    alerts.show(all.filter((alert) => alert.robot === robot.name));
    logLink.setAttribute("href", `#log/${encodeURIComponent(robot.name)}`);
    logLink.setAttribute("aria-label", `Log of ${robot.name}`);
    checkButton.setAttribute("aria-label", `Check ${robot.name}`);
    element.setAttribute("aria-label", robot.name);
    links.element.setAttribute("aria-label", `Links of ${robot.name}`);
    const isOwn = robot.name === own;
    setText(state, robot.reachable ? (isOwn ? "✓ this robot" : "✓ reachable") : "✗ not reachable");
    state.dataset.state = robot.reachable ? "good" : "bad";
    const version = robot.version ? `version ${visible(robot.version, 40)}` : "";
    const isKnown = robot.started_s !== null && now !== undefined;
    const up = isKnown ? `router started ${seconds(Math.max(0, now - robot.started_s))} ago` : "";
    setText(about, [version, up].filter(Boolean).join(", "));
    updateList(
      problems,
      robot.problems,
      (problem) => problem,
      () => h("li"),
      (item, problem) => setText(item, `⚠ ${visible(problem, 300)}`),
    );
    const connections = robot.connections ?? [];
    const shown = connections.filter((connection) => connection.state !== "connecting" && isRobot(connection));
    links.element.hidden = shown.length === 0;
    setText(none, shown.length > 0 ? "" : robot.connections === null ? "The links are not known." : "No links.");
    updateList(links.body, shown, connectionKey, row, (line, connection) =>
      line.show(connection, rates.of(robot, connection)),
    );
  };
  return element;
}

/** Returns the line of a finding of a robot's router about itself, with its advice. */
function findingItem({ about, verdict, what, advice }) {
  const mark = { good: "✓", poor: "△", wrong: "✗" }[verdict] ?? "?";
  const text = `${mark} ${visible(about, 40)}: ${visible(what, 300)}`;
  return h(
    "li",
    { "data-verdict": verdict },
    text,
    advice ? h("p", { class: "about" }, `→ ${visible(advice, 400)}`) : "",
  );
}

/** Returns whether a connection is to a robot, rather than to a program. */
function isRobot(connection) {
  return Boolean(connection.peer?.robot) || connection.state === "discovered";
}

function row() {
  const cells = LINKS.map(() => h("td"));
  const line = h("tr", {}, cells);
  const [peer, method, signal, roundTrip, urgent, sent, received, waiting, lost, since, more] = cells;
  line.show = (connection, rate) => {
    const isLinked = connection.state === "connected";
    setText(peer, visible(connection.peer?.robot ?? connection.address, 60));
    setText(method, pathText(connection));
    setText(signal, connection.rssi_dbm === null ? "–" : `${bars(connection.rssi_dbm)} ${connection.rssi_dbm} dBm`);
    setText(roundTrip, milliseconds(connection.round_trip_ms));
    const lanes = connection.lanes ?? [];
    setText(urgent, milliseconds(connection.urgent_delay_ms));
    setText(waiting, connection.lanes ? waitingText(lanes) : "–");
    setText(lost, connection.lanes ? lostText(connection) : "–");
    setText(sent, rate ? `${bytes(rate.sent)}/s` : bytes(connection.sent?.bytes));
    setText(received, rate ? `${bytes(rate.received)}/s` : bytes(connection.received?.bytes));
    setText(since, isLinked ? seconds(connection.up_s) : "");
    setText(more, isLinked ? encryption(connection.encrypted) : "in range, not linked");
    line.classList.toggle("faint", !isLinked);
  };
  return line;
}

/** Returns the bytes that wait on each lane. */
function waitingText(lanes) {
  const waits = lanes.filter((lane) => lane.waiting_bytes > 0);
  return waits.map((lane) => `${visible(lane.priority, 20)} ${bytes(lane.waiting_bytes)}`).join(", ") || bytes(0);
}

/** Returns how many batches were dropped, and the share that had to be sent again. */
function lostText({ lanes, paths }) {
  const dropped = lanes.reduce((sum, lane) => sum + lane.dropped_batches, 0);
  const resent = (paths ?? []).reduce((sum, path) => sum + path.resent_bytes, 0);
  return [`${dropped} dropped`, ...(resent > 0 ? [`${bytes(resent)} sent again`] : [])].join(", ");
}

function bars(dbm) {
  const steps = [-90, -80, -70, -60];
  return "▂▄▆█".slice(0, steps.filter((step) => dbm >= step).length) || "▁";
}

function encryption(isEncrypted) {
  return isEncrypted === null ? "linked" : isEncrypted ? "encrypted" : "not encrypted";
}
