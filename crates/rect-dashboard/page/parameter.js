// The control of one parameter: slider, number field, switch, choice, or text.

import { h } from "./dom.js";

/** The number of steps of a slider, at least. */
const STEPS = 200;

/** Returns a value as a text, as people write it. */
export function textOf(value) {
  if (typeof value === "boolean") {
    return value ? "on" : "off";
  }
  return Array.isArray(value) ? value.join(", ") || "empty" : String(value);
}

/**
 * Returns the control of a parameter: its elements, and `show(value, isDisabled)`.
 *
 * It calls `change(value, isLast)` when the user changes it; `isLast` is `false` while a slider is dragged.
 */
export function control(parameter, change) {
  switch (parameter.type) {
    case "bool":
      return toggle(parameter, change);
    case "choice":
      return choice(parameter, change);
    case "integer":
    case "number":
      return number(parameter, change);
    default:
      return field(parameter, change);
  }
}

function toggle({ name }, change) {
  const input = h("input", { type: "checkbox", role: "switch", class: "switch", "aria-label": name });
  input.addEventListener("change", () => change(input.checked));
  return {
    elements: [input],
    show(value, isDisabled) {
      input.disabled = isDisabled;
      input.checked = value === true;
    },
  };
}

function choice({ name, choices }, change) {
  const options = choices.map((text) => h("option", { value: text }, text));
  const input = h("select", { "aria-label": name, change: () => change(input.value) }, options);
  return {
    elements: [input],
    show(value, isDisabled) {
      input.disabled = isDisabled;
      input.value = value ?? "";
    },
  };
}

function number(parameter, change) {
  const { name, type, min, max } = parameter;
  const hasRange = min !== undefined && max !== undefined && max > min;
  const step = type === "integer" ? 1 : hasRange ? 10 ** Math.floor(Math.log10((max - min) / STEPS)) : "any";
  const input = h("input", { type: "number", step, min, max, "aria-label": name });
  const typed = typedField(input, (text) => (text === "" ? text : Number(text)), change);
  if (!hasRange) {
    return { elements: [typed.input], show: typed.show };
  }
  const slider = h("input", { type: "range", min, max, step, "aria-label": name });
  let isDragging = false;
  slider.addEventListener("input", () => {
    isDragging = true;
    change(Number(slider.value), false);
  });
  slider.addEventListener("change", () => {
    isDragging = false;
    change(Number(slider.value), true);
  });
  return {
    elements: [slider, typed.input],
    show(value, isDisabled) {
      slider.disabled = isDisabled;
      if (!isDragging && value !== undefined) {
        slider.value = value;
      }
      typed.show(value, isDisabled);
    },
  };
}

function field({ name, type }, change) {
  const isList = type === "numbers";
  const placeholder = isList ? "1, 2.5, 3" : "";
  const input = h("input", {
    type: "text",
    "aria-label": name,
    placeholder,
    autocapitalize: "off",
    spellcheck: "false",
  });
  const typed = typedField(input, isList ? numbers : (text) => text, change);
  return { elements: [typed.input], show: typed.show };
}

/** Returns a list of numbers, or the text if it is none, which the program refuses with a reason. */
function numbers(text) {
  const list = text
    .split(/[\s,;]+/)
    .filter(Boolean)
    .map(Number);
  return list.every(Number.isFinite) ? list : text;
}

/** Returns a field whose text counts when the user leaves it or presses Enter. Escape restores the value. */
function typedField(input, read, change) {
  let isTyping = false;
  let shown;
  const restore = () => {
    isTyping = false;
    input.value = shown === undefined ? "" : Array.isArray(shown) ? shown.join(", ") : String(shown);
  };
  input.addEventListener("input", () => {
    isTyping = true;
  });
  input.addEventListener("change", () => {
    isTyping = false;
    shown = read(input.value);
    change(shown, true);
  });
  input.addEventListener("blur", restore);
  input.addEventListener("keydown", (event) => {
    if (event.key === "Escape") {
      restore();
    }
  });
  return {
    input,
    show(value, isDisabled) {
      input.disabled = isDisabled;
      shown = value;
      if (!isTyping) {
        restore();
      }
    },
  };
}
