// The view of actions: long tasks that programs offer. Each one has a card with a form that starts it, the goals that are carried out,
// and the last ends.

import { eachFrame, h, setText, updateList, wordFilter } from "./dom.js";
import { visible } from "./format.js";
import { actionOf, condition, isOpen, phaseText, sinceText } from "./goals.js";

/** How many ends a card shows. */
const ENDS = 5;
/** The states that the view shows. */
const SHOWN = ["fleet", "actions", "feedback"];

/** Shows the actions in `parent`, until the returned function is called. */
export function actions(link, parent) {
  const filter = h("input", { type: "search", placeholder: "Filter", "aria-label": "Filter actions" });
  const empty = h("p", { class: "empty" });
  const cards = h("div", { class: "cards" });
  parent.append(h("h1", {}, "Actions"), h("div", { class: "row" }, filter), empty, cards);
  let isClosed = false;

  const show = eachFrame(() => {
    if (isClosed) {
      return;
    }
    const { fleet, actions: known } = link.states;
    const all = found(fleet?.robots ?? [], known?.goals ?? []);
    const feedback = new Map((link.states.feedback?.goals ?? []).map((news) => [goalKey(news), news]));
    const matches = wordFilter(filter);
    const shown = all.filter(({ robot, name, program, about }) => matches(`${robot} ${name} ${program} ${about}`));
    filter.hidden = all.length === 0;
    setText(empty, all.length === 0 ? emptyText(fleet) : shown.length === 0 ? "None matches." : "");
    empty.hidden = empty.textContent === "";
    updateList(
      cards,
      shown,
      ({ robot, name }) => `${robot}/${name}`,
      (action) => card(link, action),
      (element, action) => element.show(action, feedback),
    );
  });

  filter.addEventListener("input", show);
  for (const type of SHOWN) {
    link.addEventListener(type, show);
  }
  link.showActions(true);
  // The times run on.
  const timer = setInterval(show, 1000);
  show();
  return () => {
    isClosed = true;
    clearInterval(timer);
    link.showActions(false);
    for (const type of SHOWN) {
      link.removeEventListener(type, show);
    }
  };
}

function goalKey({ robot, action, id }) {
  return `${robot}/${action}/${id}`;
}

/** Returns the actions that the robots declare, and those whose goals are known, in alphabetical order. */
function found(robots, goals) {
  const all = new Map();
  const add = (robot, name, fields) => {
    const key = `${robot}/${name}`;
    const known = all.get(key) ?? { robot, name, program: "", about: "", isDeclared: false, goals: [] };
    all.set(key, { ...known, ...fields });
    return all.get(key);
  };
  for (const { name: robot, programs } of robots) {
    for (const { program, services } of programs ?? []) {
      for (const { topic, about } of services) {
        const name = actionOf(topic);
        if (name !== null) {
          add(robot, name, { program: program ?? "", about: about ?? "", isDeclared: true });
        }
      }
    }
  }
  for (const goal of goals) {
    add(goal.robot, goal.action, {}).goals.push(goal);
  }
  const reachable = new Set(robots.filter((robot) => robot.reachable).map(({ name }) => name));
  const sorted = [...all].toSorted(([one], [other]) => (one < other ? -1 : 1));
  return sorted.map(([, action]) => ({ ...action, isReachable: reachable.has(action.robot) }));
}

function emptyText(state) {
  const isKnown = state?.robots.some((robot) => robot.programs !== null);
  return isKnown ? "No program declares an action at the moment." : "Asking the routers…";
}

/** Returns why nothing can be started; empty if it can. */
function obstacleOf({ isReachable, isDeclared }) {
  if (!isReachable) {
    return "✗ cannot be reached";
  }
  return isDeclared ? "" : "✗ its program has ended";
}

function card(link, action) {
  const isReadOnly = link.states.hello.read_only;
  const place = `${action.robot}/${action.name}`;
  const program = h("span", { class: "about" });
  const badge = h("span", { class: "badge" });
  const about = h("p", { class: "about" });
  const form = isReadOnly ? null : startForm(link, action, place);
  const running = h("ul", { class: "goals", "aria-label": `Goals of ${place}` });
  const idle = h("p", { class: "about" }, "No goal is carried out.");
  const ends = h("ul", { class: "goals", "aria-label": `Ends of ${place}` });
  const lasts = h("div", {}, h("h3", {}, "Last ends"), ends);
  const element = h(
    "section",
    { class: "card action", "aria-label": place },
    h("header", {}, h("h2", {}, visible(place)), program, badge),
    about,
    form?.element,
    running,
    idle,
    lasts,
  );
  element.show = (shown, feedback) => {
    const now = Date.now();
    const obstacle = obstacleOf(shown);
    setText(program, shown.program === "" ? "" : `program ${visible(shown.program, 60)}`);
    setText(about, visible(shown.about));
    about.hidden = shown.about === "";
    setText(badge, obstacle);
    badge.dataset.state = "bad";
    form?.show(obstacle !== "");
    const open = shown.goals.filter(isOpen);
    const ended = shown.goals.filter((goal) => !isOpen(goal)).slice(0, ENDS);
    idle.hidden = open.length > 0;
    lasts.hidden = ended.length === 0;
    updateList(
      running,
      open,
      ({ id }) => id,
      (goal) => openGoal(link, goal, isReadOnly),
      (line, goal) => line.show(goal, feedback.get(goalKey(goal)), now, shown.isReachable),
    );
    updateList(
      ends,
      ended,
      ({ id }) => id,
      () => endedGoal(),
      (line, goal) => line.show(goal, now),
    );
  };
  return element;
}

function startForm(link, { robot, name }, place) {
  const value = h("textarea", { rows: 1, placeholder: '3, {"x": 1}, or a text', "aria-label": `Value for ${place}` });
  const button = h("button", { class: "primary", "aria-label": `Start ${place}` }, "Start");
  const problem = h("p", { class: "error", role: "status" });
  let isStarting = false;
  let isImpossible = false;

  async function start(event) {
    event.preventDefault();
    isStarting = true;
    update();
    try {
      await link.command("start_action", { robot, action: name, value: value.value });
      setText(problem, "");
    } catch (error) {
      setText(problem, visible(error.message, 500));
    }
    isStarting = false;
    update();
  }

  function update() {
    button.disabled = isStarting || isImpossible;
  }

  const label = h("label", { class: "wide" }, "Value, JSON or text", value);
  return {
    element: h("form", { class: "start", submit: start }, h("div", { class: "row" }, label, button), problem),
    show(isBlocked) {
      isImpossible = isBlocked;
      update();
    },
  };
}

/** Returns the line of a goal that has not ended. */
function openGoal(link, { robot, action, id }, isReadOnly) {
  const place = `${robot}/${action}/${id}`;
  const phase = h("strong");
  const since = h("span", { class: "about" });
  const bar = h("progress", { max: 1, "aria-label": `Progress of ${place}` });
  const percent = h("span");
  const news = h("p", { class: "value" });
  const value = h("p", { class: "about" });
  const problem = h("p", { class: "error", role: "status" });
  const button = isReadOnly ? null : h("button", { "aria-label": `Cancel ${place}`, click: cancel }, "Cancel");
  const line = h(
    "li",
    { "aria-label": place },
    h("div", { class: "row" }, h("div", { class: "goal-state" }, phase, " ", since), button),
    h("div", { class: "goal-progress" }, bar, percent),
    news,
    value,
    problem,
  );

  async function cancel() {
    button.disabled = true;
    try {
      await link.command("cancel_action", { robot, action, goal: id });
      setText(problem, "");
    } catch (error) {
      setText(problem, visible(error.message, 500));
    }
    button.disabled = false;
  }

  line.show = (goal, feedback, now, isReachable) => {
    const progress = feedback?.progress ?? null;
    setText(phase, phaseText(goal));
    const cut = isReachable ? "" : "; its robot cannot be reached, so this may have changed";
    setText(since, `${sinceText(goal, now)}${cut}`);
    bar.hidden = progress === null;
    bar.value = progress ?? 0;
    setText(percent, progress === null ? "progress not known" : `${Math.round(progress * 100)} %`);
    setText(news, visible(feedback?.value ?? "", 500));
    setText(value, goal.goal === null ? "" : `Value: ${visible(goal.goal, 300)}`);
    for (const part of [news, value]) {
      part.hidden = part.textContent === "";
    }
    if (button) {
      button.hidden = goal.phase === "cancelling";
    }
  };
  return line;
}

/** Returns the line of a goal that has ended. */
function endedGoal() {
  const phase = h("strong");
  const since = h("span", { class: "about" });
  const result = h("p", { class: "value" });
  const line = h("li", {}, h("div", { class: "goal-state" }, phase, " ", since), result);
  line.show = (goal, now) => {
    setText(phase, phaseText(goal));
    phase.dataset.state = condition(goal);
    setText(since, sinceText(goal, now));
    const parts = [
      goal.goal && `Value: ${visible(goal.goal, 300)}`,
      goal.result && `Result: ${visible(goal.result, 500)}`,
    ];
    setText(result, parts.filter(Boolean).join(" · "));
    result.hidden = result.textContent === "";
  };
  return line;
}
