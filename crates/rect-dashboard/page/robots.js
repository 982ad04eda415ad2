// A field for the name of a robot, which proposes those of the fleet.

import { h, updateList } from "./dom.js";

let fields = 0;

/** Returns the field as an element, and `value()`, which returns the name. */
export function robotField(link, name = "robot") {
  fields += 1;
  const id = `robots-${fields}`;
  const proposals = h("datalist", { id });
  const input = h("input", { name, list: id, required: true, placeholder: "wombat-2", autocapitalize: "off" });
  const element = h("label", {}, "Robot", input, proposals);
  // A field that is hidden is not required.
  new MutationObserver(() => {
    input.required = !element.hidden;
  }).observe(element, { attributes: true, attributeFilter: ["hidden"] });

  function update() {
    const robots = link.states.fleet?.robots ?? [];
    updateList(
      proposals,
      robots,
      (robot) => robot.name,
      (robot) => h("option", { value: robot.name }),
      () => {},
    );
  }
  link.addEventListener("fleet", update);
  update();
  return { element, input, value: () => input.value.trim() };
}
