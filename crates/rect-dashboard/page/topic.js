// One topic: its statistics, its last value as a tree, and a plot of its numbers.

import { eachFrame, h, setText } from "./dom.js";
import { bytes, hertz, milliseconds, timeOfDay, visible } from "./format.js";
import { pictureView } from "./picture.js";
import { Plot } from "./plot.js";
import { ArrivalRate } from "./rates.js";
import { valueTree } from "./tree.js";

/** How often the value is shown at most; more cannot be read. */
const TREE_EVERY_MS = 200;
/** The time over which the rate is computed. */
const RATE_OVER_MS = 5000;

/** Shows a topic in `parent`, until the returned function is called. */
export function topicPanel(link, parent, name, options = {}) {
  const figures = h("p", { class: "about figures-line", "aria-live": "off" });
  const problem = h("p", { class: "error" });
  const tree = valueTree();
  const picture = pictureView();
  const plot = new Plot(name);
  const waiting = h("p", { class: "empty" }, "No message has arrived yet.");
  parent.replaceChildren(
    ...[!options.plotOnly && h("h2", {}, visible(name)), figures, problem, waiting, plot.element].filter(Boolean),
  );
  if (!options.plotOnly) {
    parent.append(picture.element, tree.element);
  }
  const arrivals = new ArrivalRate(RATE_OVER_MS);
  let missed = 0;
  let last = null;
  let shownAt = 0;
  let timer = null;

  const show = eachFrame(() => {
    if (!last) {
      return;
    }
    const { header, value } = last;
    waiting.hidden = true;
    const parts = [
      hertz(arrivals.hertz()),
      bytes(header.bytes),
      visible(header.encoding, 60),
      `at ${timeOfDay(header.at_ms)}`,
      header.method && `by ${header.method}`,
      header.age_ms !== undefined && `${milliseconds(header.age_ms)} old`,
      header.urgent && "urgent",
      header.replayed && "replayed",
      `${missed} lost`,
    ];
    setText(figures, parts.filter(Boolean).join(" · "));
    const isVideo = header.form === "video";
    const hint = isVideo ? "This topic is a video, which Cameras shows." : "";
    setText(problem, header.problem ? visible(header.problem) : hint);
    plot.draw();
    const isPicture = header.form === "picture";
    picture.element.hidden = !isPicture;
    tree.element.hidden = isPicture || isVideo;
    if (isVideo) {
      return;
    }
    if (isPicture) {
      picture.show(value);
      return;
    }
    // A value that changes too fast to be read is shown a little later.
    const wait = shownAt + TREE_EVERY_MS - performance.now();
    clearTimeout(timer);
    if (wait > 0) {
      timer = setTimeout(show, wait);
      return;
    }
    shownAt = performance.now();
    tree.show(value);
  });

  const stop = link.watch(
    name,
    false,
    (header, value) => {
      last = { header, value };
      missed += header.missed ?? 0;
      arrivals.add();
      if (header.form === "json") {
        plot.add(header.at_ms / 1000, value);
      }
      show();
    },
    (error) => setText(problem, error),
  );
  return () => {
    stop();
    clearTimeout(timer);
    plot.close();
    parent.replaceChildren();
  };
}
