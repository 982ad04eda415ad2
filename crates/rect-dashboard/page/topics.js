// The view of topics: a list with rates, and beside it the chosen one: value, plot, and forms to publish and request.

import { eachFrame, h, setText, wordFilter } from "./dom.js";
import { bytes, hertz, visible } from "./format.js";
import { sendForm } from "./send.js";
import { topicPanel } from "./topic.js";

/** The height of a line of the list, as in style.css. Only the lines that can be seen exist. */
const LINE_PX = 44;

/** Shows the topics in `parent`, until the returned function is called. */
export function topics(link, parent, notify) {
  const filter = h("input", { type: "search", placeholder: "Filter", "aria-label": "Filter topics", input: showAll });
  const count = h("span", { class: "about" });
  const space = h("ul", { class: "lines" });
  const list = h("div", {
    class: "list scroll",
    tabindex: "0",
    role: "region",
    "aria-label": "Topics",
    scroll: () => show(),
  });
  const empty = h("p", { class: "empty" });
  const shares = h("div", { class: "about" });
  const chosen = h("div", { class: "chosen" });
  list.append(space);
  parent.append(
    h("h1", {}, "Topics"),
    h(
      "div",
      { class: "columns" },
      h("div", {}, h("div", { class: "row" }, filter, count), shares, empty, list),
      chosen,
    ),
  );
  if (!link.states.hello.read_only) {
    parent.append(sendForm(link, notify).element);
  }
  let rows = [];
  let closeTopic = null;
  let selected = null;

  function showAll() {
    const matches = wordFilter(filter);
    const known = link.states.topics?.topics ?? [];
    // The view Actions shows the goals. If you look for their topics, you get them.
    const all = filter.value.includes("actions") ? known : known.filter((row) => !row.topic.startsWith("actions/"));
    rows = all.filter((row) => matches(`${row.robot}/${row.topic}`));
    const more = link.states.topics?.more;
    setText(count, `${rows.length} of ${all.length}${more ? `, and ${more} more that the routers do not list` : ""}`);
    const links = link.states.topics?.links ?? [];
    shares.replaceChildren(...links.map((text) => h("p", {}, visible(text))));
    setText(empty, known.length > 0 ? "" : emptyText(link.states.topics));
    empty.hidden = empty.textContent === "";
    list.hidden = rows.length === 0;
    space.style.height = `${rows.length * LINE_PX}px`;
    show();
  }

  const show = eachFrame(() => {
    const first = Math.max(0, Math.floor(list.scrollTop / LINE_PX) - 5);
    const last = Math.ceil((list.scrollTop + list.clientHeight) / LINE_PX) + 5;
    const lines = rows.slice(first, last).map((row, index) => line(row, first + index));
    const focused = document.activeElement?.dataset?.topic;
    space.replaceChildren(...lines);
    if (focused) {
      space.querySelector(`[data-topic="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
    }
  });

  function line(row, index) {
    const name = `${row.robot}/${row.topic}`;
    const { hz, bytes_per_s: rate, on_air_per_s: onAir, last_bytes: size, encoding } = row;
    const air = onAir > 0 ? ` (${bytes(onAir)}/s on the air)` : "";
    const lost = row.lost > 0 ? ` · ${row.lost} lost` : "";
    const retained = row.is_retained ? " · retained" : "";
    const button = h(
      "button",
      { "data-topic": name, "aria-pressed": String(name === selected), click: () => choose(name) },
      h("span", { class: "name" }, visible(name)),
      h(
        "span",
        { class: "figures" },
        `${hertz(hz)} · ${bytes(rate)}/s${air} · ${bytes(size)} · ${visible(encoding, 40)}${lost}${retained}`,
      ),
    );
    const item = h("li", {}, button);
    item.style.top = `${index * LINE_PX}px`;
    return item;
  }

  function choose(name) {
    selected = name;
    closeTopic?.();
    closeTopic = topicPanel(link, chosen, name);
    history.replaceState(null, "", `#topics/${encodeURIComponent(name)}`);
    show();
  }

  link.addEventListener("topics", showAll);
  link.showTopics(true);
  showAll();
  const named = decodeURIComponent(location.hash.split("/").slice(1).join("/"));
  if (named) {
    choose(named);
  } else {
    chosen.append(h("p", { class: "empty" }, "Choose a topic to see its value and to plot it."));
  }
  return () => {
    link.removeEventListener("topics", showAll);
    link.showTopics(false);
    closeTopic?.();
  };
}

function emptyText(state) {
  if (!state) {
    return "The routers count messages for a second…";
  }
  return state.problem ?? "No robot publishes anything at the moment. Publish something: `rect pub arm/angle 12`.";
}
