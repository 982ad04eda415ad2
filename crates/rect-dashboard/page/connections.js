// The view of named connections: those of each robot, with forms to add and remove them.

import { eachFrame, h, setText, table, updateList } from "./dom.js";
import { seconds, visible } from "./format.js";
import { robotField } from "./robots.js";

const COLUMNS = ["Robot", "Name", "Method", "Address", "State", "Change"];
const FIELDS = ["name", "method", "address", "port"];

/** Shows the connections in `parent`, until the returned function is called. */
export function connections(link, parent, notify) {
  const lines = table("Named connections", COLUMNS);
  const empty = h("p", { class: "empty" }, "No robot has a named connection. Robots also connect without: see Fleet.");
  const isReadOnly = link.states.hello.read_only;
  parent.append(h("h1", {}, "Connections"), empty, lines.element);
  if (!isReadOnly) {
    parent.append(addForm(link, notify));
  }

  const show = eachFrame(() => {
    const robots = link.states.fleet?.robots ?? [];
    const all = robots.flatMap((robot) =>
      (robot.connections ?? [])
        .filter((connection) => connection.name !== null)
        .map((connection) => ({ robot: robot.name, connection })),
    );
    empty.hidden = all.length > 0;
    lines.element.hidden = all.length === 0;
    updateList(
      lines.body,
      all,
      ({ robot, connection }) => `${robot}\n${connection.name}`,
      ({ robot, connection }) => row(robot, connection.name),
      (line, { connection }) => line.show(connection),
    );
  });

  function row(robot, name) {
    const cells = COLUMNS.map(() => h("td"));
    const line = h("tr", {}, cells);
    const remove = h(
      "button",
      { click: () => disconnect(robot, name), "aria-label": `Remove ${name} of ${robot}` },
      "Remove",
    );
    if (!isReadOnly) {
      cells[5].append(remove);
    }
    line.show = (connection) => {
      const texts = [
        robot,
        visible(name, 60),
        connection.method,
        visible(connection.address, 60),
        stateText(connection),
      ];
      for (const [index, text] of texts.entries()) {
        setText(cells[index], text);
      }
    };
    return line;
  }

  async function disconnect(robot, name) {
    if (!confirm(`Remove the connection ${name} of ${robot}? Its link is closed.`)) {
      return;
    }
    try {
      await link.command("disconnect", { robot, name });
      notify(`Removed ${name} of ${robot}`);
    } catch (error) {
      notify(error.message, true);
    }
  }

  link.addEventListener("fleet", show);
  show();
  return () => link.removeEventListener("fleet", show);
}

function stateText({ state, up_s: up, last_error: error }) {
  if (state === "connected") {
    return `✓ connected for ${seconds(up)}`;
  }
  const reason = error ? `: ${visible(error.what, 120)} (${seconds(error.ago_s)} ago)` : "";
  return `… ${state}${reason}`;
}

/** Returns the field that a router's error is about, such as `tcp needs a port`; `undefined` if it is about none. */
function fieldOf(text) {
  const [, problem] = text.split("cannot be added: ");
  const words = problem?.match(/\w+/g) ?? [];
  return words.find((word) => FIELDS.includes(word));
}

function addForm(link, notify) {
  const robot = robotField(link);
  robot.input.value = link.states.hello.robot;
  const inputs = {
    name: h("input", { required: true, placeholder: "base", autocapitalize: "off" }),
    method: h("select", {}, ...["ble", "any", "tcp", "udp", "tls"].map((method) => h("option", {}, method))),
    address: h("input", { required: true, placeholder: "wombat-2, or 192.168.125.2", autocapitalize: "off" }),
    port: h("input", { type: "number", min: 1, max: 65535, placeholder: "7447" }),
  };
  const labels = { name: "Name", method: "Method", address: "Robot or host", port: "Port, for tcp, udp and tls" };
  const errors = {};
  const general = h("p", { class: "error", role: "alert" });
  const fields = FIELDS.map((field) => {
    errors[field] = h("span", { class: "error", id: `error-${field}` });
    inputs[field].name = field;
    inputs[field].setAttribute("aria-describedby", `error-${field}`);
    return h("label", {}, labels[field], inputs[field], errors[field]);
  });
  const form = h(
    "form",
    { class: "send", submit: add, "aria-label": "Add a connection" },
    h("h2", {}, "Add or replace a connection"),
    h("div", { class: "fields" }, robot.element, fields),
    h("div", { class: "row" }, h("button", { class: "primary" }, "Add"), general),
  );

  async function add(event) {
    event.preventDefault();
    showError("");
    const port = inputs.port.value === "" ? null : Number(inputs.port.value);
    const connection = {
      name: inputs.name.value.trim(),
      method: inputs.method.value,
      address: inputs.address.value.trim(),
      port,
    };
    try {
      await link.command("connect", { robot: robot.value(), connection });
      notify(`${robot.value()} has the connection ${connection.name} now`);
    } catch (error) {
      showError(error.message);
    }
  }

  /** Shows an error at the field that it is about. */
  function showError(text) {
    const place = fieldOf(text);
    for (const field of FIELDS) {
      setText(errors[field], field === place ? visible(text, 400) : "");
      inputs[field].setAttribute("aria-invalid", String(field === place));
    }
    setText(general, place ? "" : visible(text, 400));
    if (place) {
      inputs[place].focus();
    }
  }

  return form;
}
