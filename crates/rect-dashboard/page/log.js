// The view of logs: a console of the lines that the programs of all robots log. Lines cross the links only while a page shows it.

import { eachFrame, h, setText, updateList, wordFilter } from "./dom.js";
import { seconds, timeOfDay, visible } from "./format.js";
import { LogLines } from "./log-lines.js";

const LEVELS = ["debug", "info", "warn", "error"];
/** How often new lines are drawn, at most. */
const DRAWN_EVERY_MS = 150;
/** How far from its end the console may be scrolled and still follow. */
const END_PX = 24;
/** How long the router of a robot may take to answer. */
const ANSWERED_WITHIN_MS = 5000;
const MAX_TEXT = 10_000;
const DAY_MS = 24 * 3600 * 1000;

/** Shows the logs in `parent`, until the returned function is called. */
export function log(link, parent) {
  const chosen = decodeURIComponent(location.hash.split("/")[1] ?? "");
  const robot = choice("Robot", "All robots", chosen);
  const program = choice("Program", "All programs");
  const level = h(
    "select",
    { change: onLevel },
    LEVELS.map((name) =>
      h("option", { value: name, selected: name === "info" }, name === LEVELS.at(-1) ? name : `≥ ${name}`),
    ),
  );
  const filter = h("input", { type: "search", placeholder: "Filter", "aria-label": "Filter lines", input: onFilter });
  const extras = h("input", {
    type: "checkbox",
    checked: true,
    change: () => consoleArea.classList.toggle("is-brief"),
  });
  const pause = h("button", { click: () => setFollowing(!isFollowing) });
  const count = h("span", { class: "about" });
  const notes = h("ul", { class: "problems" });
  const empty = h("p", { class: "empty" });
  const consoleArea = h("div", {
    class: "console",
    role: "log",
    tabindex: "0",
    "aria-label": "Lines",
    scroll: onScroll,
  });
  parent.append(
    h("h1", {}, "Log"),
    h(
      "div",
      { class: "row filters" },
      robot.element,
      program.element,
      h("label", { class: "field" }, "Level", level),
      filter,
      pause,
      h("label", { class: "check" }, extras, "fields and source"),
      count,
    ),
    notes,
    empty,
    consoleArea,
  );
  const lines = new LogLines();
  /** The robots that have answered since the level was chosen. */
  let answered = new Set();
  let asked = Date.now();
  let isFollowing = true;
  /** The number of new lines that are not drawn because the console is paused. */
  let waiting = 0;
  let stop = null;
  let timer = null;

  function onLevel() {
    // The new reading begins before the old one ends, so that a router does not stop in between.
    const last = stop;
    answered = new Set();
    asked = Date.now();
    stop = link.watchLog(level.value, receive);
    last?.();
    onFilter();
  }

  function receive(header, value) {
    const { robot: name, is_new: isNew, has_answered: hasAnswered } = value;
    if (hasAnswered) {
      answered.add(name);
    }
    const added = lines.add(value, header.at_ms);
    if (!isFollowing && isNew) {
      waiting += added.filter(selected()).length;
    }
    drawSoon();
  }

  function drawSoon() {
    timer ??= setTimeout(() => {
      timer = null;
      draw();
    }, DRAWN_EVERY_MS);
  }

  /** Returns a function that tells whether the filters select a line. */
  function selected() {
    const matches = wordFilter(filter);
    const least = LEVELS.indexOf(level.value);
    return (line) =>
      LEVELS.indexOf(line.level) >= least &&
      (robot.value() === "" || line.robot === robot.value()) &&
      (program.value() === "" || line.program === program.value()) &&
      matches(line.searched);
  }

  function onFilter() {
    if (isFollowing) {
      draw();
    } else {
      setFollowing(true);
    }
  }

  function onScroll() {
    const isAtEnd = consoleArea.scrollTop + consoleArea.clientHeight >= consoleArea.scrollHeight - END_PX;
    if (isAtEnd !== isFollowing) {
      setFollowing(isAtEnd);
    }
  }

  function setFollowing(follows) {
    isFollowing = follows;
    waiting = 0;
    // The lines of the pause are drawn together, and not read out one by one.
    consoleArea.setAttribute("aria-live", "off");
    draw();
    consoleArea.setAttribute("aria-live", follows ? "polite" : "off");
  }

  const draw = eachFrame(() => {
    if (isFollowing) {
      const shown = lines.all.filter(selected());
      drawLines(consoleArea, shown);
      consoleArea.scrollTop = consoleArea.scrollHeight;
      setText(count, `${shown.length} of ${lines.all.length} lines`);
      setText(empty, shown.length > 0 ? "" : emptyText());
      empty.hidden = shown.length > 0;
      consoleArea.hidden = shown.length === 0;
    }
    const news = waiting === 1 ? "1 new line" : `${waiting} new lines`;
    setText(pause, isFollowing ? "Pause" : waiting > 0 ? `Continue: ${news}` : "Continue");
    update();
  });

  /** Shows which robots there are, and which of them are silent. */
  function update() {
    const robots = link.states.fleet?.robots ?? [];
    const names = new Set([...robots.map(({ name }) => name), ...lines.robots()]);
    robot.show([...names].toSorted());
    program.show(lines.programs(robot.value()));
    const now = (link.states.time?.at_s ?? 0) * 1000;
    const others = [...names].filter((name) => name !== link.states.hello.robot);
    const texts = others.map((name) => [name, noteOf(name, robots, now)]);
    updateList(
      notes,
      texts.filter(([name, text]) => text !== "" && (robot.value() === "" || robot.value() === name)),
      ([name]) => name,
      () => h("li"),
      (item, [, text]) => setText(item, `⚠ ${text}`),
    );
    const isSilent = (name) => !robots.find((other) => other.name === name)?.reachable;
    const silentNames = new Set([...lines.robots()].filter(isSilent));
    for (const element of consoleArea.children) {
      element.classList.toggle("is-old", silentNames.has(element.line.robot));
    }
  }

  function noteOf(name, robots, now) {
    const state = robots.find((other) => other.name === name);
    const seen = lines.lastSeen(name);
    const age = seen === undefined ? "" : `its last line was seen ${seconds(Math.max(0, (now - seen) / 1000))} ago`;
    if (!state?.reachable) {
      const since = state?.silent_since_ms ? ` since ${timeText(state.silent_since_ms)}` : "";
      return age === "" ? "" : `${visible(name, 60)} is silent${since}: ${age}`;
    }
    const isLate = Date.now() - asked > ANSWERED_WITHIN_MS;
    return answered.has(name) || !isLate ? "" : `${visible(name, 60)} has not answered${age === "" ? "" : `: ${age}`}`;
  }

  function emptyText() {
    if (lines.all.length > 0) {
      return "No line matches the filters.";
    }
    return answered.size === 0
      ? "Asking the routers…"
      : "No program has logged anything. `rect run -- python3 app.py` logs the output of a program.";
  }

  const resized = new ResizeObserver(() => {
    if (isFollowing) {
      consoleArea.scrollTop = consoleArea.scrollHeight;
    }
  });
  resized.observe(consoleArea);
  for (const { input } of [robot, program]) {
    input.addEventListener("change", onFilter);
  }
  link.addEventListener("fleet", drawSoon);
  link.addEventListener("time", drawSoon);
  stop = link.watchLog(level.value, receive);
  setFollowing(true);
  return () => {
    clearTimeout(timer);
    resized.disconnect();
    link.removeEventListener("fleet", drawSoon);
    link.removeEventListener("time", drawSoon);
    stop?.();
  };
}

/** Returns a field to choose a name, or all. */
function choice(label, all, initial = "") {
  const input = h("select", {}, h("option", { value: "" }, all));
  const names = h("optgroup", { label: `${label}s` });
  input.append(names);
  let known = [];
  function show(found) {
    // A name that is chosen stays, although nothing has it at the moment.
    const value = input.value || initial;
    const listed = value === "" || found.includes(value) ? found : [...found, value].toSorted();
    if (listed.join("\n") !== known.join("\n")) {
      known = listed;
      names.replaceChildren(...listed.map((name) => h("option", { value: name }, visible(name, 60))));
      input.value = value;
    }
    initial = "";
  }
  show([]);
  return { element: h("label", { class: "field" }, label, input), input, show, value: () => input.value };
}

/** Makes `parent` show these lines. The elements of those that it shows already stay where they are. */
function drawLines(parent, shown) {
  const kept = new Set(shown);
  const surplus = [...parent.children].filter((element) => !kept.has(element.line));
  for (const element of surplus) {
    element.remove();
  }
  let place = parent.firstElementChild;
  for (const line of shown) {
    if (place?.line === line) {
      place = place.nextElementSibling;
    } else {
      parent.insertBefore(entry(line), place);
    }
  }
  while (place) {
    const next = place.nextElementSibling;
    place.remove();
    place = next;
  }
}

function entry(line) {
  const { robot, program, level, at, text, logger, fields, source } = line;
  const values = Object.entries(fields ?? {}).map(([name, value]) => `${name}=${JSON.stringify(value)}`);
  const extra = [logger, ...values, source].filter(Boolean).join("  ");
  const from = program === "" ? robot : `${robot}/${program}`;
  const element = h(
    "div",
    { class: "entry", "data-level": level },
    h("span", { class: "when", title: dateText(at) }, timeText(at, true)),
    h("span", { class: "level" }, level),
    h("span", { class: "program", title: visible(from) }, visible(from)),
    h(
      "div",
      { class: "text" },
      visible(text, MAX_TEXT),
      extra ? h("span", { class: "extra" }, visible(extra, 2000)) : null,
    ),
  );
  element.line = line;
  return element;
}

/** Returns a time, with the date if it is not about now. The clock of a robot may be years off. */
function timeText(ms, hasMilliseconds = false) {
  if (!isDate(ms)) {
    return "unknown time";
  }
  const fraction = hasMilliseconds ? `.${String(ms % 1000).padStart(3, "0")}` : "";
  const day = Math.abs(Date.now() - ms) < DAY_MS / 2 ? "" : `${dateText(ms).slice(0, 10)} `;
  return `${day}${timeOfDay(ms)}${fraction}`;
}

function dateText(ms) {
  return isDate(ms) ? new Date(ms).toISOString() : "";
}

function isDate(ms) {
  return !Number.isNaN(new Date(ms).getTime());
}
