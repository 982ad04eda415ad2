// Builds elements. Texts are only ever set as text, so nothing that a robot sends is interpreted as HTML.

const SVG = "http://www.w3.org/2000/svg";

/** Returns an element. `properties` are attributes, except functions, which are event listeners. */
export function h(name, properties = {}, ...children) {
  return build(document.createElement(name), properties, children);
}

/** Returns an element of a picture. */
export function svg(name, properties = {}, ...children) {
  return build(document.createElementNS(SVG, name), properties, children);
}

function build(element, properties, children) {
  for (const [name, value] of Object.entries(properties)) {
    if (typeof value === "function") {
      element.addEventListener(name, value);
    } else if (value === true) {
      element.setAttribute(name, "");
    } else if (value !== false && value !== null && value !== undefined) {
      element.setAttribute(name, value);
    }
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

/** Sets the text of an element if it has changed, so that a selection in it survives. */
export function setText(element, text) {
  if (element.textContent !== text) {
    element.textContent = text;
  }
}

/**
 * Makes `parent` contain an element for each item, in their order. An element stays while its item's key does.
 *
 * `create(item)` returns a new element, and `update(element, item)` makes it show the item.
 */
export function updateList(parent, items, key, create, update) {
  const old = parent.elementsByKey ?? new Map();
  const elements = new Map();
  let place = parent.firstElementChild;
  for (const item of items) {
    const name = key(item);
    if (elements.has(name)) {
      continue;
    }
    const element = old.get(name) ?? create(item);
    update(element, item);
    elements.set(name, element);
    if (element === place) {
      place = place.nextElementSibling;
    } else {
      parent.insertBefore(element, place);
    }
  }
  for (const [name, element] of old) {
    if (!elements.has(name)) {
      element.remove();
    }
  }
  parent.elementsByKey = elements;
}

/** Returns a function that calls `paint` once in the next frame, however often it is called. */
export function eachFrame(paint) {
  let isDue = false;
  return () => {
    if (isDue) {
      return;
    }
    isDue = true;
    requestAnimationFrame(() => {
      isDue = false;
      paint();
    });
  };
}

/** Returns a table with these columns, and its body. */
export function table(label, columns) {
  const body = h("tbody");
  const head = columns.map((column) => h("th", { scope: "col" }, column));
  return {
    element: h(
      "div",
      { class: "scroll", tabindex: "0", role: "region", "aria-label": label },
      h("table", {}, h("thead", {}, h("tr", {}, head)), body),
    ),
    body,
  };
}

/** Returns a function that tells whether a text contains all words in a field. */
export function wordFilter(field) {
  const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
  return (text) => {
    const lower = text.toLowerCase();
    return words.every((word) => lower.includes(word));
  };
}
