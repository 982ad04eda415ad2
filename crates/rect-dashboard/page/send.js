// The form that publishes a message, sends one to a robot, or sends a request to a service.

import { h, setText } from "./dom.js";
import { milliseconds, visible } from "./format.js";
import { robotField } from "./robots.js";

/** Returns the form as an element, and `request(robot, service)`, which fills it in. */
export function sendForm(link, notify, first = "publish") {
  const kind = h(
    "select",
    { name: "kind", change: update },
    h("option", { value: "publish" }, "Publish to all robots"),
    h("option", { value: "send" }, "Send to one robot"),
    h("option", { value: "request" }, "Request a service"),
  );
  const robot = robotField(link);
  const topic = h("input", { name: "topic", required: true, placeholder: "arm/angle", autocapitalize: "off" });
  const value = h("textarea", { name: "value", rows: 2, placeholder: '12.5, {"force": 3}, or a text' });
  const urgent = h("input", { type: "checkbox", name: "urgent" });
  const urgentLabel = h("label", { class: "check" }, urgent, "urgent");
  const topicName = h("span", {}, "Topic");
  const button = h("button", { class: "primary" }, "Publish");
  const result = h("output", { class: "result" });
  const form = h(
    "form",
    { class: "send", submit: send, "aria-label": "Publish and request" },
    h("h2", {}, "Publish and request"),
    h("div", { class: "fields" }, [
      h("label", {}, "What", kind),
      robot.element,
      h("label", {}, topicName, topic),
      h("label", { class: "wide" }, "Value, JSON or text", value),
    ]),
    h("div", { class: "row" }, button, urgentLabel, result),
  );

  function update() {
    robot.element.hidden = kind.value === "publish";
    urgentLabel.hidden = kind.value === "request";
    setText(topicName, kind.value === "request" ? "Service" : "Topic");
    setText(button, { publish: "Publish", send: "Send", request: "Request" }[kind.value]);
  }

  async function send(event) {
    event.preventDefault();
    const common = { topic: topic.value.trim(), value: value.value };
    button.disabled = true;
    result.className = "result";
    setText(result, "…");
    try {
      if (kind.value === "request") {
        const { reply, ms } = await link.command("request", { ...common, robot: robot.value() });
        setText(result, `${visible(JSON.stringify(reply), 2000)} (after ${milliseconds(ms)})`);
      } else {
        const to = kind.value === "send" ? robot.value() : null;
        await link.command("publish", { ...common, to, urgent: urgent.checked });
        setText(result, to === null ? "Published." : `Sent to ${to}.`);
      }
    } catch (error) {
      result.className = "result error";
      setText(result, error.message);
      notify(error.message, true);
    }
    button.disabled = false;
  }

  function request(name, service) {
    kind.value = "request";
    robot.input.value = name;
    topic.value = service;
    setText(result, "");
    update();
    form.scrollIntoView({ block: "nearest" });
    value.focus({ preventScroll: true });
  }

  kind.value = first;
  update();
  return { element: form, request };
}
