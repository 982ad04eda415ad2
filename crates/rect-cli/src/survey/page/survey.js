// Shows the survey in the element `data`: tables, and plots beside the curves of theory and of the simulated air.

const { survey, expected } = JSON.parse(document.getElementById("data").textContent);
const main = document.querySelector("main");
// Colours that differ in brightness, too; the curves for comparison are grey and dashed.
const COLOURS = ["#0b3c8c", "#c2410c", "#15803d", "#7e22ce", "#0e7490", "#a16207", "#be185d"];
const GREYS = ["#555", "#777", "#999"];
const DASHES = [
  [6, 4],
  [2, 3],
  [10, 4, 2, 4],
  [1, 6],
];
const WIDTH = Math.min(900, document.documentElement.clientWidth - 40);

function add(name, text, parent = main) {
  const element = document.createElement(name);
  element.textContent = text ?? "";
  parent.append(element);
  return element;
}

function table(head, rows) {
  const element = add("table");
  const box = document.createElement("div");
  box.className = "wide";
  element.replaceWith(box);
  box.append(element);
  const line = add("tr", "", add("thead", "", element));
  head.forEach((text) => add("th", text, line));
  const body = add("tbody", "", element);
  for (const row of rows) {
    const cells = add("tr", "", body);
    row.forEach((text) => add("td", text ?? "–", cells));
  }
}

/** Draws lines, each of which has its own points. */
function plot(title, { x, y, lines, logX = false, maxY }) {
  add("h2", title);
  const shown = lines.filter((line) => line.points.length > 0);
  const all = [...new Set(shown.flatMap((line) => line.points.map(([at]) => at)))].toSorted((a, b) => a - b);
  if (all.length === 0) {
    add("p", "Not measured.");
    return null;
  }
  const values = shown.map((line) => {
    const known = new Map(line.points);
    return all.map((at) => known.get(at) ?? null);
  });
  const series = shown.map((line) => ({
    label: line.name,
    stroke: line.colour,
    dash: line.dash,
    width: 2,
    spanGaps: true,
    points: { show: !line.dash, size: 6 },
  }));
  const scaleY = { range: (_, low, high) => (low < 0 ? [low - 3, high + 3] : [0, maxY ?? high * 1.05]) };
  const options = {
    width: WIDTH,
    height: 340,
    scales: { x: { time: false, distr: logX ? 3 : 1 }, y: scaleY },
    axes: [{ label: x }, { label: y }],
    series: [{ label: x }, ...series],
    legend: { live: false },
    cursor: { drag: { setScale: false } },
  };
  return new uPlot(options, [all, ...values], add("div"));
}

/** Returns the places with a link over Bluetooth. */
const overRadio = (places) => places.filter((place) => place.path !== "tcp");
const isMeasured = (place) => place.error === null;
const measured = survey.places.filter(isMeasured);
const simulated = overRadio(expected.simulated.places.filter(isMeasured));
const colour = (index) => COLOURS[index % COLOURS.length];
const dash = (index) => DASHES[index % DASHES.length];
const grey = (index) => GREYS[index % GREYS.length];
const loads = (place) => place.sent.map((load) => [load.bytes, load.kb_per_s]);
const quantile = (curve, share) => curve?.curve.find(([of]) => of === share)?.[1];
const ms = (value) => (value === undefined || value === null ? null : `${value.toFixed(value < 10 ? 1 : 0)} ms`);
const best = (all) => (all.length ? `${Math.max(...all.map((load) => load.kb_per_s)).toFixed(1)} kB/s` : null);
const signalOf = (place) => place.discovery?.signal_dbm ?? null;
/** Returns the median of the times until the other robot was discovered. */
const discoveredAfter = (discovery) => {
  const sorted = (discovery?.seconds ?? []).toSorted((a, b) => a - b);
  return sorted.length > 0 ? `${sorted[Math.floor(sorted.length / 2)].toFixed(2)} s` : null;
};
const lost = (place) =>
  [...place.sent, ...place.received, place.round_trip, place.round_trip_under_load]
    .filter(Boolean)
    .reduce((sum, one) => sum + one.lost, 0);

const [own, other] = survey.robots;
document.title = `RECT survey: ${own.name} and ${other.name}`;
add("h1", `${own.name} and ${other.name}, linked by ${survey.link.method}`);
add("p", `Made by rect survey ${survey.rect_version} at ${survey.date}.`);

for (const place of survey.places.filter((one) => one.resembles)) {
  add("p", `${place.label}, the goodput is that of a radio with ${place.resembles}.`);
}
if (survey.link.batch_bytes) {
  add("p", `The Bluetooth link accepts batches of up to ${survey.link.batch_bytes} bytes.`);
}

add("h2", "Not as expected");
if (survey.deviations.length === 0) {
  add("p", "Nothing: everything is as on the simulated air, or better.");
} else {
  const list = add("ul");
  list.className = "deviations";
  survey.deviations.forEach((text) => add("li", text, list));
}

add("h2", "Places");
table(
  [
    "place",
    "path",
    "signal",
    "discovered after",
    "round trip, p50",
    "p99",
    "beside a load, p50",
    "p99",
    "sent",
    "received",
    "lost",
  ],
  survey.places.map((place) =>
    isMeasured(place)
      ? [
          place.label,
          place.path,
          signalOf(place) === null ? null : `${signalOf(place)} dBm`,
          discoveredAfter(place.discovery),
          ms(quantile(place.round_trip, 0.5)),
          ms(quantile(place.round_trip, 0.99)),
          ms(quantile(place.round_trip_under_load, 0.5)),
          ms(quantile(place.round_trip_under_load, 0.99)),
          best(place.sent),
          best(place.received),
          String(lost(place)),
        ]
      : [place.label, place.error],
  ),
);

const radio = overRadio(measured);
plot("Goodput by size of the messages", {
  x: "bytes of a message",
  y: "kB/s",
  logX: true,
  lines: [
    ...radio.map((place, index) => ({ name: place.label, points: loads(place), colour: colour(index) })),
    ...simulated.slice(0, 1).map((place) => ({
      name: `simulated air, ${place.label}`,
      points: loads(place),
      colour: "#000",
      dash: [4, 4],
    })),
    ...expected.goodput.map((theory, index) => ({
      name: `theory: ${theory.name}`,
      points: theory.points,
      colour: grey(index),
      dash: dash(index),
    })),
  ],
});

const shares = (curve) => (curve ? curve.curve.map(([share, time]) => [time, share * 100]) : []);
plot("Round trip of urgent requests", {
  x: "ms",
  y: "% of the requests took at most this long",
  maxY: 102,
  lines: [
    ...radio.flatMap((place, index) => [
      { name: place.label, points: shares(place.round_trip), colour: colour(index) },
      {
        name: `${place.label}, beside a load`,
        points: shares(place.round_trip_under_load),
        colour: colour(index),
        dash: [8, 4],
      },
    ]),
    ...simulated.slice(0, 1).map((place) => ({
      name: `simulated air, ${place.label}`,
      points: shares(place.round_trip),
      colour: "#000",
      dash: [3, 4],
    })),
  ],
});

const free = radio.filter((place) => place.distance_m !== null && !place.behind_body && signalOf(place) !== null);
const body = radio.filter((place) => place.distance_m !== null && place.behind_body && signalOf(place) !== null);
const signal = (places) => places.map((place) => [place.distance_m, signalOf(place)]);
if (free.length > 0) {
  plot("Signal by distance", {
    x: "metres",
    y: "dBm",
    logX: true,
    lines: [
      { name: "measured", points: signal(free), colour: colour(0) },
      { name: "with a person in between", points: signal(body), colour: colour(1) },
      { name: "free space, 0 dBm", points: expected.free_space, colour: grey(0), dash: dash(0) },
    ],
  });
}

add("h2", "Loss and return of the link");
for (const { noticed_s, reachable_s } of survey.reconnections) {
  add(
    "p",
    `The loss was noticed after ${noticed_s.toFixed(1)} s; ${reachable_s.toFixed(1)} s after the radio was back, the robots reached each other again.`,
  );
}
for (const { path, reason, gap_ms, longest_round_trip_ms, sent, lost: missing } of survey.switches) {
  add(
    "p",
    `Switch to ${path} (${reason}): data waited ${ms(gap_ms)}, the longest round trip was ${ms(longest_round_trip_ms)}, ${missing} of ${sent} messages were lost.`,
  );
}
if (survey.soak) {
  const { seconds, round_trip } = survey.soak;
  add(
    "p",
    `Watched for ${Math.round(seconds)} s: ${round_trip.replies} replies, ${round_trip.lost} lost, p99 ${ms(quantile(round_trip, 0.99))}, longest ${ms(quantile(round_trip, 1))}.`,
  );
}

add("h2", "Computers and adapters");
table(
  ["robot", "model", "system", "kernel", "adapters"],
  survey.robots.map(({ name, computer }) => [
    name,
    computer.model,
    `${computer.system ?? "?"}, ${computer.architecture}`,
    computer.kernel,
    computer.adapters.map((one) => [one.name, one.driver, one.usb].filter(Boolean).join(" ")).join(", ") || "none",
  ]),
);
for (const { name, computer } of survey.robots) {
  for (const [command, output] of Object.entries(computer.outputs)) {
    add("h3", `${name}: ${command}`);
    add("pre", output);
  }
}
