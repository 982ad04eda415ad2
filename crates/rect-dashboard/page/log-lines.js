// The lines that the page has, in the order in which they are shown.

/** The largest number of lines. Beyond it, the oldest ones are removed. */
const MAX_LINES = 5000;

/** The lines of all robots. */
export class LogLines {
  /** The lines in their order. */
  all = [];
  #keys = new Set();
  /** When the last line of each robot was received by the dashboard, in milliseconds since 1970. */
  #seen = new Map();

  /** Takes over lines of a robot that arrived at a time of the dashboard's clock. Returns those that it did not have. */
  add({ robot, lines, is_new: isNew, missed }, arrived) {
    const added = [];
    for (const line of lines) {
      const key = `${robot}\n${line.program}\n${line.number}\n${line.at}`;
      this.#seen.set(robot, Math.max(line.seen, this.#seen.get(robot) ?? 0));
      if (!this.#keys.has(key)) {
        this.#keys.add(key);
        // New lines are at the end, whatever the clock of their robot says. Earlier ones are among the others by their times.
        const order = isNew ? arrived : Math.min(line.at, line.seen);
        added.push({ ...line, robot, key, order, searched: searchedText(robot, line) });
      }
    }
    if (missed && this.all.at(-1)?.key !== `${robot} missed`) {
      added.push(missedLine(robot, arrived));
    }
    const isLast = added.length === 0 || compare(this.all.at(-1) ?? added[0], added[0]) <= 0;
    this.all.push(...added);
    if (!isNew || !isLast) {
      this.all.sort(compare);
    }
    for (const { key } of this.all.splice(0, Math.max(0, this.all.length - MAX_LINES))) {
      this.#keys.delete(key);
    }
    return added;
  }

  /** Returns when the last line of a robot was received; `undefined` if there is none. */
  lastSeen(robot) {
    return this.#seen.get(robot);
  }

  /** Returns the robots that have lines. */
  robots() {
    return this.#seen.keys();
  }

  /** Returns the programs of a robot, or of all (`""`), in alphabetical order. */
  programs(robot) {
    const own = this.all.filter((line) => line.program !== "" && (robot === "" || line.robot === robot));
    return [...new Set(own.map(({ program }) => program))].toSorted();
  }
}

function compare(one, other) {
  const byName = one.robot < other.robot ? -1 : 1;
  return one.order - other.order || (one.robot === other.robot ? one.number - other.number : byName);
}

function searchedText(robot, { program, level, logger, text, fields, source }) {
  return [robot, program, level, logger, text, source, fields ? JSON.stringify(fields) : ""].join(" ");
}

function missedLine(robot, arrived) {
  const text = "Lines were missed: the program logs faster than the link carries.";
  return {
    robot,
    program: "",
    level: "warn",
    at: Math.round(arrived),
    number: Infinity,
    text,
    searched: text,
    key: `${robot} missed`,
    order: arrived,
  };
}
