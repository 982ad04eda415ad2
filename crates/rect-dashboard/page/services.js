// The view of the services: what the programs of each robot offer, and a form to send requests to them.

import { actionOf } from "./goals.js";
import { eachFrame, h, setText, table, updateList } from "./dom.js";
import { visible } from "./format.js";
import { sendForm } from "./send.js";

/** Shows the services in `parent`, until the returned function is called. */
export function services(link, parent, notify) {
  const empty = h("p", { class: "empty" });
  const cards = h("div", { class: "cards" });
  const form = link.states.hello.read_only ? null : sendForm(link, notify, "request");
  parent.append(h("h1", {}, "Services"), empty, cards);
  if (form) {
    parent.append(form.element);
  }
  const show = eachFrame(() => {
    const robots = (link.states.fleet?.robots ?? []).filter((robot) => robot.reachable && robot.programs?.length > 0);
    setText(empty, robots.length > 0 ? "" : emptyText(link.states.fleet));
    empty.hidden = empty.textContent === "";
    updateList(
      cards,
      robots,
      (robot) => robot.name,
      () => card(form),
      (element, robot) => element.show(robot),
    );
  });
  link.addEventListener("fleet", show);
  show();
  return () => link.removeEventListener("fleet", show);
}

function emptyText(state) {
  const isKnown = state?.robots.some((robot) => robot.programs !== null);
  return isKnown ? "No program serves anything at the moment." : "Asking the routers…";
}

function card(form) {
  const name = h("h2");
  const list = table("Services", ["Program", "Service", "Description", ...(form ? ["Request"] : [])]);
  const element = h("section", { class: "card" }, h("header", {}, name), list.element);
  element.show = (robot) => {
    setText(name, robot.name);
    element.setAttribute("aria-label", robot.name);
    list.element.setAttribute("aria-label", `Services of ${robot.name}`);
    updateList(
      list.body,
      robot.programs.flatMap(lines),
      ({ program, service }) => `${program.instance}/${service?.topic ?? ""}`,
      () => row(form),
      (line, shown) => line.show(robot.name, shown),
    );
  };
  return element;
}

/** Returns the services of a program; one line without a service if it has none. */
function lines(program) {
  const ordinary = program.services.filter(
    ({ topic, parameters }) => parameters === undefined && actionOf(topic) === null,
  );
  const served = ordinary.map((service) => ({ program, service }));
  return served.length > 0 ? served : [{ program, service: null }];
}

function row(form) {
  const cells = ["", "", ""].map(() => h("td"));
  const [program, topic, about] = cells;
  let shownService = null;
  const button = form ? h("button", { click: () => form.request(...shownService) }, "Request…") : null;
  const line = h("tr", {}, cells, form ? h("td", {}, button) : null);
  line.show = (robot, shown) => {
    setText(program, shown.program.program ?? "–");
    setText(topic, shown.service?.topic ?? "serves nothing");
    setText(about, visible(shown.service?.about ?? "", 200));
    line.classList.toggle("faint", shown.service === null);
    if (button) {
      button.hidden = shown.service === null;
      button.setAttribute("aria-label", `Request ${robot}/${topic.textContent}`);
      shownService = [robot, shown.service?.topic];
    }
  };
  return line;
}
