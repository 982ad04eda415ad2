// The page: its header, and the view that the address selects.

import { alertCount } from "./alerts.js";
import { cameras } from "./cameras.js";
import { h, setText } from "./dom.js";
import { embedded } from "./embedded.js";
import { events } from "./events.js";
import { fleet } from "./fleet.js";
import { bytes } from "./format.js";
import { Link } from "./link.js";
import { services } from "./services.js";
import { stopButton } from "./stop.js";
import { topics } from "./topics.js";

const VIEWS = {
  fleet,
  log: later(() => import("./log.js").then((view) => view.log)),
  topics,
  services,
  actions: later(() => import("./actions.js").then((view) => view.actions)),
  parameters: later(() => import("./parameters.js").then((view) => view.parameters)),
  cameras,
  connections: later(() => import("./connections.js").then((view) => view.connections)),
  events,
};
const NAMES = {
  fleet: "Fleet",
  log: "Log",
  topics: "Topics",
  services: "Services",
  actions: "Actions",
  parameters: "Parameters",
  cameras: "Cameras",
  connections: "Connections",
  events: "Events",
};

const LOGIN_NEEDED = "To publish or change something, log in with one of the team's login file";

const link = new Link();
const content = document.getElementById("content");
const notices = document.getElementById("notices");
let closeView = () => {};
/** Whether the view was shown for a page that may only look; `undefined` before the first view. */
let shownReadOnly;

/** Returns a view that is loaded once it is opened, so that the page stays small. */
function later(load) {
  return (to, parent, inform) => {
    let close = null;
    let isClosed = false;
    load().then(
      (view) => {
        close = isClosed ? null : view(to, parent, inform);
      },
      () => parent.append(h("p", { class: "empty" }, "The view cannot be loaded: is the dashboard still running?")),
    );
    return () => {
      isClosed = true;
      close?.();
    };
  };
}

/** Shows a message for some seconds. */
function notify(text, isError = false) {
  const notice = h("p", { class: isError ? "notice error" : "notice" }, text);
  notices.append(notice);
  setTimeout(() => notice.remove(), isError ? 12_000 : 5000);
}

/** Shows the view, once it is known whether the page may only look: a view that is replaced loses what was typed into it. */
function show() {
  if (!link.states.hello) {
    return;
  }
  shownReadOnly = link.states.hello.read_only;
  const name = location.hash.slice(1).split("/")[0];
  const chosen = Object.hasOwn(VIEWS, name) ? name : "fleet";
  closeView();
  content.replaceChildren();
  content.className = chosen;
  closeView = VIEWS[chosen](link, content, notify) ?? (() => {});
  for (const anchor of document.querySelectorAll("nav a")) {
    if (anchor.getAttribute("href") === `#${chosen}`) {
      anchor.setAttribute("aria-current", "page");
    } else {
      anchor.removeAttribute("aria-current");
    }
  }
  document.title = `${NAMES[chosen]} – RECT dashboard`;
}

function header() {
  const title = h("span", { class: "title" }, "RECT");
  const condition = h("span", { class: "condition", role: "status" });
  const dropped = h("span", { class: "dropped" });
  const commands = h("div", { class: "commands" });
  const stop = stopButton(link);
  const entries = Object.entries(NAMES).map(([name, text]) => h("a", { href: `#${name}` }, text));
  link.addEventListener("hello", () => {
    const { robot, fleet: name, read_only: readOnly, logged_in: loggedIn, record } = link.states.hello;
    setText(title, `RECT · ${name}`);
    title.title = `connected through ${robot}${readOnly ? ", read-only" : ""}`;
    commands.replaceChildren(
      ...[
        record && !readOnly && recordButton(),
        stop.button,
        loggedIn === true && h("form", { method: "post", action: "/logout" }, h("button", {}, "Log out")),
        loggedIn === false && h("form", { action: "/login" }, h("button", { title: LOGIN_NEEDED }, "Log in")),
      ].filter(Boolean),
    );
  });
  link.addEventListener("hello", () => {
    if (shownReadOnly !== link.states.hello.read_only) {
      show();
    }
  });
  link.addEventListener("dropped", () => {
    const { count } = link.states.dropped;
    setText(dropped, count > 0 ? `${count} values skipped: this browser is too slow` : "");
  });
  const showCondition = () => {
    const router = link.states.fleet?.connected !== false;
    const isOpen = link.condition === "open";
    const texts = { connecting: "connecting…", lost: `disconnected, trying again… ${link.reason ?? ""}` };
    setText(condition, isOpen ? (router ? "live" : "the router does not answer") : texts[link.condition]);
    condition.dataset.state = isOpen && router ? "good" : "bad";
    document.body.classList.toggle("stale", !isOpen);
  };
  link.addEventListener("condition", showCondition);
  link.addEventListener("fleet", showCondition);
  showCondition();
  document
    .getElementById("header")
    .append(
      title,
      condition,
      alertCount(link),
      dropped,
      h("nav", { "aria-label": "Views" }, entries),
      commands,
      stop.area,
    );
}

function recordButton() {
  const text = h("span", {}, "Record");
  const button = h("button", { class: "record", click: toggle }, text);
  let isRecording = false;
  function update() {
    const state = link.states.recording;
    isRecording = Boolean(state?.file);
    button.dataset.state = isRecording ? "on" : "off";
    button.title = isRecording ? `Stop recording ${state.file}` : "Record what this robot publishes";
    const dropped = state?.dropped ? `, ${state.dropped} dropped` : "";
    setText(text, isRecording ? `Recording ${bytes(state.bytes)}${dropped}` : "Record");
    if (state?.problem) {
      button.title = `The disk takes nothing at the moment: ${state.problem}`;
    }
  }
  async function toggle() {
    try {
      const file = await link.command("record", { on: !isRecording });
      notify(isRecording ? `Recorded ${file}` : `Recording to ${file}`);
    } catch (error) {
      notify(error.message, true);
    }
  }
  link.addEventListener("recording", update);
  update();
  return button;
}

const embed = new URLSearchParams(location.search).get("embed");
if (embed === null) {
  header();
  addEventListener("hashchange", show);
} else {
  document.getElementById("header").remove();
  content.className = "embedded";
  embedded(link, content, embed);
}
link.start();
