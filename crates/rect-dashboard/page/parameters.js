// The view of parameters: the groups that programs declare, with a control for each parameter. The program decides which values are in
// force; a value that it has not confirmed yet is marked.

import { eachFrame, h, setText, updateList, wordFilter } from "./dom.js";
import { visible } from "./format.js";
import { ParameterGroup } from "./parameter-group.js";
import { control, textOf } from "./parameter.js";

/** Shows the parameters in `parent`, until the returned function is called. */
export function parameters(link, parent) {
  const filter = h("input", { type: "search", placeholder: "Filter", "aria-label": "Filter parameters" });
  const empty = h("p", { class: "empty" });
  const cards = h("div", { class: "cards" });
  parent.append(h("h1", {}, "Parameters"), h("div", { class: "row" }, filter), empty, cards);
  /** The groups that were declared since the view was opened. */
  const groups = new Map();
  let isClosed = false;

  const show = eachFrame(() => {
    if (isClosed) {
      // A group that is added now would be received for ever.
      return;
    }
    update(groups, link, show);
    const matches = wordFilter(filter);
    const isShown = (group, { name }) => matches(`${group.robot} ${group.program} ${group.name} ${name}`);
    const shown = [...groups.values()].filter((group) => group.declaration.some((one) => isShown(group, one)));
    filter.hidden = groups.size === 0;
    setText(empty, groups.size === 0 ? emptyText(link.states.fleet) : shown.length === 0 ? "None matches." : "");
    empty.hidden = empty.textContent === "";
    updateList(
      cards,
      shown,
      ({ robot, name, declaration }) => JSON.stringify([robot, name, declaration]),
      (group) => card(group, link.states.hello.read_only),
      (element, group) => element.show((parameter) => isShown(group, parameter)),
    );
  });
  filter.addEventListener("input", show);
  link.addEventListener("fleet", show);
  show();
  return () => {
    isClosed = true;
    link.removeEventListener("fleet", show);
    for (const group of groups.values()) {
      group.close();
    }
  };
}

/** Takes over what the robots declare. A group that is not declared any more stays, so that it is seen that its program has ended. */
function update(groups, link, onChange) {
  const robots = link.states.fleet?.robots ?? [];
  const declared = new Set();
  for (const robot of robots.filter(({ reachable }) => reachable)) {
    for (const { program, services } of robot.programs ?? []) {
      for (const { topic, about, parameters: declaration } of services) {
        if (!declaration) {
          continue;
        }
        const name = topic.split("/").at(-1);
        const key = `${robot.name}/${name}`;
        declared.add(key);
        if (!groups.has(key)) {
          groups.set(key, new ParameterGroup(link, robot.name, name, onChange));
        }
        Object.assign(groups.get(key), { program: program ?? "", about: about ?? "", declaration });
      }
    }
  }
  const reachable = new Set(robots.filter((robot) => robot.reachable).map((robot) => robot.name));
  for (const [key, group] of groups) {
    group.isReachable = reachable.has(group.robot);
    group.isDeclared = declared.has(key);
  }
}

function emptyText(state) {
  const isKnown = state?.robots.some((robot) => robot.programs !== null);
  return isKnown ? "No program declares parameters at the moment." : "Asking the routers…";
}

function card(group, isReadOnly) {
  const name = `${group.robot}/${group.name}`;
  const program = h("span", { class: "about" });
  const condition = h("span", { class: "badge" });
  const about = h("p", { class: "about" });
  const problem = h("p", { class: "error", role: "status" });
  const by = h("span", { class: "about by" });
  const undo = h("button", { click: () => group.undo() });
  const resetAll = h("button", { "aria-label": `Reset all of ${name}`, click: () => group.reset() }, "Reset all");
  const rows = group.declaration.map((parameter) => row(group, parameter, isReadOnly));
  const element = h(
    "section",
    { class: "card group", "aria-label": name },
    h("header", {}, h("h2", {}, visible(name)), program, condition),
    about,
    rows.map((line) => line.element),
    problem,
    h("div", { class: "row" }, isReadOnly ? null : [undo, resetAll], by),
  );
  element.show = (isShown) => {
    setText(program, group.program === "" ? "" : `program ${visible(group.program, 60)}`);
    setText(about, visible(group.about));
    const obstacle = group.condition();
    setText(condition, obstacle);
    condition.dataset.state = "bad";
    setText(problem, visible(group.problem, 500));
    for (const line of rows) {
      line.show(isShown);
    }
    setText(by, byText(group));
    const back = group.undoable();
    undo.hidden = back.length === 0;
    setText(undo, `Undo ${back.join(", ")}`);
    resetAll.hidden = !group.declaration.some((one) => !one.read_only && !group.isDefault(one));
    for (const button of [undo, resetAll]) {
      button.disabled = obstacle !== "";
    }
  };
  return element;
}

function byText({ snapshot }) {
  if (!snapshot?.changed?.length) {
    return "";
  }
  const names = snapshot.changed.length > 4 ? `${snapshot.changed.length} parameters` : snapshot.changed.join(", ");
  return `${visible(names)} last changed by ${snapshot.by ? visible(snapshot.by, 100) : "the program itself"}`;
}

function row(group, parameter, isReadOnly) {
  const { name, unit, about, default: initial } = parameter;
  const isFixed = isReadOnly || parameter.read_only === true;
  const value = isFixed ? h("output", { class: "value" }) : null;
  const input = isFixed ? null : control(parameter, (changed, isLast) => group.set(name, changed, isLast));
  const mark = h("span", { class: "pending" }, "not yet confirmed");
  const standard = `default ${textOf(initial)}${unit ? ` ${unit}` : ""}`;
  const fixed = parameter.read_only ? "set by its program" : visible(standard, 60);
  const reset = h("button", { "aria-label": `Reset ${name}`, click: () => group.reset(name) }, "Reset");
  const problem = h("p", { class: "error", role: "status" });
  const element = h(
    "div",
    { class: "parameter", role: "group", "aria-label": name },
    h(
      "div",
      { class: "what" },
      h("strong", {}, visible(name)),
      unit ? h("span", { class: "about" }, ` ${visible(unit)}`) : null,
      mark,
      about ? h("p", { class: "about" }, visible(about)) : null,
    ),
    h("div", { class: "control" }, value ?? input.elements),
    h("div", { class: "standard" }, h("span", { class: "about" }, fixed), isFixed ? null : reset),
    problem,
  );
  return {
    element,
    show(isShown) {
      element.hidden = !isShown(parameter);
      const now = group.value(name);
      element.classList.toggle("is-pending", group.isPending(name));
      reset.hidden = group.isDefault(parameter);
      reset.disabled = group.condition() !== "";
      setText(problem, visible(group.problems.get(name) ?? "", 500));
      if (value) {
        setText(value, now === undefined ? "–" : visible(textOf(now), 200));
      } else {
        input.show(now, group.condition() !== "" || now === undefined);
      }
    },
  };
}
