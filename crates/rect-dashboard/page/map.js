// Draws the map of the fleet: the robots on a circle, with a line for each link.

import { h, svg } from "./dom.js";
import { milliseconds, pathText, visible } from "./format.js";

/** The largest number of robots whose names have room inside their shapes, and their links for labels. */
const MANY = 12;
/** The distance of a robot's name from its dot, if there are many. */
const NAME_GAP = 10;

/** Replaces the content of `figure` by the map of these robots. `own` is the name of the robot that serves the page. */
export function drawMap(figure, robots, own) {
  const names = namesOf(robots);
  const isMany = names.length > MANY;
  const size = { width: 640, height: isMany ? 640 : names.length > 3 ? 320 : 180 };
  // The longest names are written outside the circle.
  const margin = isMany ? { x: 140, y: 140 } : { x: 90, y: 50 };
  const places = placesOf(names, size, margin);
  const known = new Map(robots.map((robot) => [robot.name, robot]));
  const links = linksOf(robots);
  const label = `${names.length} robots, ${links.length} links`;
  const explanation = isMany
    ? "Solid: linked. Dashed: in range, not linked."
    : "Solid: linked. Dashed: in range, not linked. The label is the path and its round trip.";
  figure.replaceChildren(
    svg(
      "svg",
      { class: isMany && "many", viewBox: `0 0 ${size.width} ${size.height}`, role: "img", "aria-label": label },
      links.map((link) => line(link, places, !isMany)),
      names.map((name) => node(name, known.get(name), name === own, places.get(name), isMany)),
    ),
    h("figcaption", {}, explanation),
  );
}

/** Returns the names of the robots and of their peers; a number in a name counts as one: wombat-2 is before wombat-10. */
function namesOf(robots) {
  const peers = robots.flatMap((robot) => robot.connections ?? []).map((connection) => connection.peer?.robot);
  const names = new Set([...robots.map((robot) => robot.name), ...peers.filter(Boolean)]);
  return [...names].toSorted(new Intl.Collator("en", { numeric: true }).compare);
}

/** Returns the place of each name on an ellipse, and its direction from the centre. */
function placesOf(names, size, margin) {
  const centre = { x: size.width / 2, y: size.height / 2 };
  const radius = names.length === 1 ? { x: 0, y: 0 } : { x: centre.x - margin.x, y: centre.y - margin.y };
  const place = (_, index) => {
    const angle = Math.PI + (2 * Math.PI * index) / names.length;
    return { x: centre.x + radius.x * Math.cos(angle), y: centre.y + radius.y * Math.sin(angle), angle };
  };
  return new Map(names.map((name, index) => [name, place(name, index)]));
}

/** Draws a robot: its name inside a shape, or beside a dot if there are many. */
function node(name, robot, isOwn, { x, y, angle }, isMany) {
  const state = robot?.reachable ? (robot.problems.length > 0 ? "warn" : "good") : "bad";
  const shape = isMany ? svg("circle", { r: 5 }) : svg("rect", { x: -70, y: -18, width: 140, height: 36, rx: 18 });
  return svg(
    "g",
    { class: `node ${state}${isOwn ? " own" : ""}`, transform: `translate(${x} ${y})` },
    shape,
    svg("text", isMany ? outward(angle) : { "text-anchor": "middle", dy: "0.35em" }, visible(name, 16)),
  );
}

/** Returns how a name is written outside the circle, so that it can be read from the left to the right. */
function outward(angle) {
  const degrees = (angle * 180) / Math.PI;
  const isLeft = Math.cos(angle) < 0;
  return {
    transform: `rotate(${isLeft ? degrees - 180 : degrees})`,
    x: isLeft ? -NAME_GAP : NAME_GAP,
    dy: "0.35em",
    "text-anchor": isLeft ? "end" : "start",
  };
}

/** Returns the links without their second ends. */
function linksOf(robots) {
  const links = new Map();
  for (const robot of robots) {
    for (const connection of robot.connections ?? []) {
      const peer = connection.peer?.robot;
      if (!peer || connection.state === "connecting") {
        continue;
      }
      const ends = [robot.name, peer].toSorted();
      const key = [...ends, connection.state === "connected" ? connection.method : ""].join("\n");
      const known = links.get(key);
      if (!known || known.connection.round_trip_ms === null) {
        links.set(key, { ends, connection });
      }
    }
  }
  return [...links.values()];
}

function line({ ends, connection }, places, hasLabel) {
  const [from, to] = ends.map((end) => places.get(end));
  const isLinked = connection.state === "connected";
  // Not in the middle, where lines cross.
  const label = { x: from.x + 0.36 * (to.x - from.x), y: from.y + 0.36 * (to.y - from.y) };
  const text = isLinked && hasLabel ? `${pathText(connection)} ${milliseconds(connection.round_trip_ms)}` : "";
  return svg(
    "g",
    { class: isLinked ? "line" : "line discovered" },
    svg("line", { x1: from.x, y1: from.y, x2: to.x, y2: to.y }),
    svg("text", { x: label.x, y: label.y - 6, "text-anchor": "middle" }, text),
  );
}
