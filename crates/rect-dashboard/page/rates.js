// Computes rates: from the counters of links, and of what arrives.

/** The rates of all links in bytes per second. A router reports its counters every few seconds. */
export class Rates {
  #links = new Map();

  /** Takes the newest reports of the robots. */
  update(robots) {
    const links = new Map();
    for (const robot of robots) {
      for (const connection of robot.connections ?? []) {
        const key = keyOf(robot, connection);
        links.set(key, next(this.#links.get(key), connection));
      }
    }
    this.#links = links;
  }

  /** Returns the rates of a link, `{ sent, received }`. `null` if they are not known yet. */
  of(robot, connection) {
    return this.#links.get(keyOf(robot, connection))?.rate ?? null;
  }
}

function keyOf(robot, connection) {
  return `${robot.name}\n${connectionKey(connection)}`;
}

/** Returns a text that identifies a connection among those of its robot. */
export function connectionKey({ name, method, address }) {
  return [name, method, address].join("\n");
}

/** Counts arrivals over the last `overMs` milliseconds. */
export class ArrivalRate {
  #arrivals = [];
  #overMs;

  constructor(overMs) {
    this.#overMs = overMs;
  }

  add() {
    this.#arrivals.push(performance.now());
  }

  /** Returns the arrivals per second. */
  hertz() {
    const since = performance.now() - this.#overMs;
    while (this.#arrivals.length > 0 && this.#arrivals[0] < since) {
      this.#arrivals.shift();
    }
    return this.#arrivals.length / (this.#overMs / 1000);
  }
}

function next(before, { up_s: up, sent, received }) {
  const now = { up, sent: sent?.bytes, received: received?.bytes, rate: null };
  if (before && now.up === before.up) {
    return before;
  }
  const passed = before ? now.up - before.up : 0;
  if (passed > 0 && now.sent >= before.sent && now.received >= before.received) {
    now.rate = { sent: (now.sent - before.sent) / passed, received: (now.received - before.received) / passed };
  }
  return now;
}
