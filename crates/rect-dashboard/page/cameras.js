// The view of cameras: pictures and streams side by side.

import { eachFrame, h, setText } from "./dom.js";
import { bytes, hertz, milliseconds, visible } from "./format.js";
import { pictureView } from "./picture.js";
import { ArrivalRate } from "./rates.js";
import { videoView } from "./video.js";

const RATE_OVER_MS = 3000;
const CHOSEN = "rect-cameras";

/** Shows all cameras in `parent`, or those of `robot`, until the returned function is called. */
export function cameras(link, parent, _notify, only = null) {
  const grid = h("div", { class: "grid" });
  const empty = h("p", { class: "empty" });
  const open = new Map();
  if (only === null) {
    const field = h("input", { placeholder: "wombat-2/camera", "aria-label": "Topic of the camera", required: true });
    const form = h("form", { class: "row", submit: add }, field, h("button", {}, "Show"));
    parent.append(h("h1", {}, "Cameras"), form);
    function add(event) {
      event.preventDefault();
      remember([...chosen(), field.value.trim()]);
      field.value = "";
      show();
    }
  }
  parent.append(empty, grid);

  function show() {
    const found = (link.states.topics?.topics ?? []).filter(({ encoding }) => /^(image|video)\//i.test(encoding));
    const names = new Set(found.map(({ robot, topic }) => `${robot}/${topic}`));
    for (const name of only === null ? chosen() : only.includes("/") ? [only] : []) {
      names.add(name);
    }
    for (const name of names) {
      const isIncluded = only === null || name === only || name.startsWith(`${only}/`);
      if (isIncluded && !open.has(name)) {
        const card = camera(link, name, only === null ? () => close(name) : null);
        open.set(name, card);
        grid.append(card.element);
      }
    }
    setText(empty, open.size > 0 ? "" : "No robot sends pictures at the moment. Cameras appear here by themselves.");
    empty.hidden = open.size > 0;
  }

  function close(name) {
    remember(chosen().filter((other) => other !== name));
    open.get(name).close();
    open.delete(name);
    show();
  }

  link.addEventListener("topics", show);
  link.showTopics(true);
  show();
  return () => {
    link.removeEventListener("topics", show);
    link.showTopics(false);
    for (const card of open.values()) {
      card.close();
    }
  };
}

/** Returns the cameras that the user has added. */
function chosen() {
  try {
    return JSON.parse(localStorage.getItem(CHOSEN)) ?? [];
  } catch {
    return [];
  }
}

function remember(names) {
  localStorage.setItem(CHOSEN, JSON.stringify([...new Set(names)].slice(-16)));
}

function camera(link, name, remove) {
  const picture = pictureView();
  const figures = h("figcaption", { class: "about" }, "No frame has arrived yet.");
  const problem = h("p", { class: "error" });
  const hide = remove && h("button", { click: remove, "aria-label": `Remove ${name}` }, "×");
  const element = h(
    "figure",
    { class: "camera", "aria-label": name },
    h("div", { class: "row" }, h("strong", {}, visible(name, 60)), hide),
    picture.element,
    figures,
    problem,
  );
  picture.canvas.hidden = true;
  const arrivals = new ArrivalRate(RATE_OVER_MS);
  let last = null;
  let skipped = 0;

  const show = eachFrame(() => {
    const now = performance.now();
    const rate = hertz(arrivals.hertz());
    const age = last.header.age_ms === undefined ? "age unknown" : `${milliseconds(last.header.age_ms)} old`;
    const silent = now - last.at > RATE_OVER_MS ? ` · no frame for ${milliseconds(now - last.at)}` : "";
    setText(figures, `${rate} · ${age} · ${bytes(last.header.bytes)} · ${skipped} skipped${silent}`);
  });
  const timer = setInterval(() => last && show(), 1000);
  const video = videoView(picture.canvas, problem, () => link.askForKey(receive));
  const stop = link.watch(name, true, receive, (error) => setText(problem, error));

  function receive(header, value) {
    last = { header, at: performance.now() };
    arrivals.add();
    skipped += header.missed ?? 0;
    if (header.form === "video") {
      video.show(header, value);
    } else if (header.form === "picture") {
      setText(problem, "");
      picture.show(value);
    } else {
      setText(problem, header.problem ?? "This topic has no pictures; see Topics for its values.");
    }
    show();
  }

  return {
    element,
    close() {
      stop();
      video.close();
      clearInterval(timer);
      element.remove();
    },
  };
}
