// A group of parameters of a robot's program: the values in force, and those that this page has set and the program has not confirmed.

/** How often changed values are sent at most. The last one is always sent. */
const SEND_EVERY_MS = 100;
/** How long the program's answer counts more than a message with the values, which may have been under way before. */
const ANSWER_COUNTS_MS = 500;

export class ParameterGroup {
  program = "";
  about = "";
  declaration = [];
  isReachable = true;
  isDeclared = true;
  /** The last message with the values. */
  snapshot = null;
  /** Why the last change of several parameters was refused, or why there are no values. */
  problem = "";
  /** Why the last change of a parameter was refused. */
  problems = new Map();
  #link;
  #onChange;
  #hasEnded = false;
  #close;
  /** The changes that wait to be sent: values, or `undefined` for the default. */
  #waiting = new Map();
  /** The values that the program has not confirmed. */
  #pending = new Map();
  #answered = new Map();
  /** The values before the last change of this page. */
  #before = new Map();
  #isDragging = false;
  #isSending = false;
  #sentAt = -SEND_EVERY_MS;

  constructor(link, robot, name, onChange) {
    this.robot = robot;
    this.name = name;
    this.#link = link;
    this.#onChange = onChange;
    this.#close = link.watch(
      `${robot}/parameters/${name}`,
      false,
      (header, value) => this.#receive(header, value),
      (problem) => {
        this.problem = problem;
        onChange();
      },
    );
  }

  close() {
    this.#close();
  }

  /** Returns why nothing can be changed; empty if it can. */
  condition() {
    if (!this.isReachable) {
      return "✗ cannot be reached";
    }
    return this.#hasEnded || !this.isDeclared ? "✗ its program has ended" : "";
  }

  /** Returns the value to show. */
  value(name) {
    return this.#pending.has(name) ? this.#pending.get(name) : this.#inForce(name);
  }

  isPending(name) {
    return this.#pending.has(name);
  }

  isDefault({ name, default: initial }) {
    const value = this.value(name);
    return value === undefined || isEqual(value, initial);
  }

  /** Changes a parameter. `isLast`: `false` while a slider is dragged; all of that is one change. */
  set(name, value, isLast = true) {
    if (!this.#isDragging) {
      this.#begin([name]);
    }
    this.#isDragging = !isLast;
    if (!isEqual(value, this.value(name))) {
      this.#put(name, value, value);
    }
    this.#send();
  }

  /** Gives a parameter, or all, the default. */
  reset(only = null) {
    const isChanged = (one) => !one.read_only && !this.isDefault(one) && (only === null || one.name === only);
    const changed = this.declaration.filter(isChanged);
    this.#begin(changed.map(({ name }) => name));
    for (const { name, default: initial } of changed) {
      this.#put(name, undefined, initial);
    }
    this.#send();
  }

  /** Undoes the last change of this page. */
  undo() {
    const before = [...this.#before].filter(([name]) => this.undoable().includes(name));
    this.#before = new Map();
    for (const [name, value] of before) {
      this.#put(name, value, value);
    }
    this.#send();
  }

  /** Returns the names of the parameters that the last change of this page has changed, and that can be changed back. */
  undoable() {
    return [...this.#before].filter(([name, value]) => !isEqual(value, this.value(name))).map(([name]) => name);
  }

  #inForce(name) {
    return this.#answered.has(name) ? this.#answered.get(name) : this.snapshot?.values?.[name];
  }

  #begin(names) {
    this.#before = new Map(names.map((name) => [name, this.#inForce(name)]));
    this.problem = "";
    this.problems = new Map();
  }

  #put(name, sent, shown) {
    this.#waiting.set(name, sent);
    this.#pending.set(name, shown);
  }

  #receive(header, value) {
    if (value === null || typeof value !== "object" || typeof value.values !== "object") {
      return;
    }
    this.snapshot = value;
    this.#hasEnded = header.ended === true;
    this.#onChange();
  }

  /** Sends what has changed, unless an answer is still due: a slow link gets no more than it carries. */
  async #send() {
    this.#onChange();
    if (this.#isSending || this.#waiting.size === 0) {
      return;
    }
    this.#isSending = true;
    const wait = this.#sentAt + SEND_EVERY_MS - performance.now();
    if (wait > 0) {
      await new Promise((resolve) => setTimeout(resolve, wait));
    }
    this.#sentAt = performance.now();
    // An order sets values or resets them; the others are sent next.
    const waiting = [...this.#waiting];
    const isReset = waiting[0][1] === undefined;
    const sent = waiting.filter(([, value]) => (value === undefined) === isReset);
    for (const [name] of sent) {
      this.#waiting.delete(name);
    }
    const set = isReset ? {} : Object.fromEntries(sent);
    const reset = isReset ? sent.map(([name]) => name) : [];
    // One that has changed again meanwhile is not confirmed by this answer, nor refused.
    const names = () => sent.map(([name]) => name).filter((name) => !this.#waiting.has(name));
    try {
      const values = await this.#link.command("set_parameters", { robot: this.robot, group: this.name, set, reset });
      for (const name of names()) {
        this.#pending.delete(name);
        this.#onAnswer(name, values[name]);
      }
    } catch (error) {
      for (const name of names()) {
        this.#pending.delete(name);
      }
      if (sent.length === 1) {
        this.problems.set(sent[0][0], error.message);
      } else {
        this.problem = error.message;
      }
    }
    this.#isSending = false;
    this.#send();
  }

  #onAnswer(name, value) {
    if (value === undefined) {
      return;
    }
    this.#answered.set(name, value);
    setTimeout(() => {
      if (this.#answered.get(name) === value) {
        this.#answered.delete(name);
        this.#onChange();
      }
    }, ANSWER_COUNTS_MS);
  }
}

function isEqual(one, other) {
  return JSON.stringify(one) === JSON.stringify(other);
}
