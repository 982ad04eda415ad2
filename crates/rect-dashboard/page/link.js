// The connection to the program that serves the page (crates/rect-dashboard/src/protocol.rs).

import { canDecode } from "./video.js";

const VERSION = 8;
const STATE = 1;
/** How long nothing may arrive before the connection counts as lost. The program sends the time every 3 s. */
const SILENT_AFTER_MS = 10_000;
const RETRY_MS = [250, 500, 1000, 2000, 4000];
/** How long the question whether the login has ended may take. */
const ASKED_FOR_MS = 3000;
const RELOADED = "rect-reloaded";

/** Sends commands, receives states and values, and connects again by itself. Dispatches an event for each type of state. */
export class Link extends EventTarget {
  /** The newest state of each type. */
  states = {};
  /** `connecting`, `open`, or `lost`. */
  condition = "connecting";
  /** When something was received, by the clock of this browser. */
  #received = 0;
  #socket = null;
  #attempts = 0;
  #timer = null;
  #nextId = 1;
  #answers = new Map();
  #watches = new Map();
  #shows = { topics: false, actions: false };

  start() {
    this.#connect();
    setInterval(() => this.#check(), 1000);
    // Timers stand still while the computer sleeps.
    for (const event of ["online", "focus", "pageshow"]) {
      addEventListener(event, () => this.#wake());
    }
    document.addEventListener("visibilitychange", () => this.#wake());
  }

  /** Sends a command, and returns its answer. Fails with a text for the user. */
  command(type, fields = {}) {
    if (this.condition !== "open") {
      return Promise.reject(new Error("The dashboard is not connected at the moment"));
    }
    const id = this.#nextId++;
    this.#send({ type, id, ...fields });
    return new Promise((resolve, reject) => this.#answers.set(id, { resolve, reject }));
  }

  /** Calls `receive(header, value)` for each value of a topic, until the returned function is called. */
  watch(topic, stream, receive, fail = () => {}) {
    return this.#begin({ type: "watch", topic, stream, video: stream && canDecode }, receive, fail);
  }

  /** Calls `receive(header, value)` for lines of `level` and above of all robots, until the returned function is called. */
  watchLog(level, receive) {
    return this.#begin({ type: "log", level }, receive, () => {});
  }

  #begin(command, receive, fail) {
    const id = this.#nextId++;
    const watch = { command: { ...command, id }, receive, fail };
    this.#watches.set(id, watch);
    this.#send(watch.command);
    return () => {
      this.#watches.delete(id);
      this.#send({ type: "unwatch", id });
    };
  }

  /** Asks for a key frame of the video that `receive` gets. */
  askForKey(receive) {
    const watch = [...this.#watches.values()].find((other) => other.receive === receive);
    if (watch) {
      this.#send({ type: "key", id: watch.command.id });
    }
  }

  /** Sets whether the list of topics is shown. */
  showTopics(topics) {
    this.#show({ topics });
  }

  /** Sets whether the goals of actions are shown. */
  showActions(actions) {
    this.#show({ actions });
  }

  #show(shown) {
    this.#shows = { ...this.#shows, ...shown };
    this.#send({ type: "show", ...this.#shows });
  }

  #connect() {
    clearTimeout(this.#timer);
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(`${scheme}//${location.host}/socket`);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    this.#received = Date.now();
    socket.addEventListener("open", () => {
      this.#send({ type: "show", ...this.#shows });
      for (const { command } of this.#watches.values()) {
        this.#send(command);
      }
    });
    socket.addEventListener("message", (event) => {
      if (socket === this.#socket) {
        this.#onMessage(event.data);
      }
    });
    socket.addEventListener("close", (event) => {
      if (socket === this.#socket) {
        this.#onClose(event.reason);
      }
    });
  }

  #onMessage(data) {
    this.#received = Date.now();
    if (!(data instanceof ArrayBuffer)) {
      return;
    }
    const kind = new Uint8Array(data, 0, 1)[0];
    if (kind === STATE) {
      this.#receiveState(JSON.parse(decode(data, 1)));
      return;
    }
    const length = new DataView(data).getUint32(1, true);
    const header = JSON.parse(decode(data, 5, length));
    const watch = this.#watches.get(header.id);
    if (watch) {
      const start = 5 + length;
      const value = header.form === "json" ? JSON.parse(decode(data, start)) : new Uint8Array(data, start);
      watch.receive(header, value);
    }
  }

  #receiveState(state) {
    if (state.type === "answer") {
      this.#onAnswer(state);
      return;
    }
    if (state.type === "hello") {
      if (state.version !== VERSION && !sessionStorage.getItem(RELOADED)) {
        sessionStorage.setItem(RELOADED, "yes");
        location.reload();
        return;
      }
      sessionStorage.removeItem(RELOADED);
      this.#attempts = 0;
      this.#setCondition("open", "");
    }
    this.states[state.type] = state;
    this.dispatchEvent(new Event(state.type));
  }

  #onAnswer({ id, value, error }) {
    const asked = this.#answers.get(id);
    this.#answers.delete(id);
    if (error === null) {
      asked?.resolve(value);
    } else if (asked) {
      asked.reject(new Error(error));
    } else {
      this.#watches.get(id)?.fail(error);
    }
  }

  #onClose(reason) {
    this.#socket = null;
    for (const { reject } of this.#answers.values()) {
      reject(new Error("The connection was lost; it is not known whether the command was executed"));
    }
    this.#answers.clear();
    this.#setCondition("lost", reason);
    if (reason === "the login has ended") {
      location.reload();
      return;
    }
    const wait = RETRY_MS[Math.min(this.#attempts, RETRY_MS.length - 1)];
    this.#attempts += 1;
    this.#timer = setTimeout(() => this.#retry(), wait);
  }

  async #retry() {
    // A socket does not say that the login has ended, for example because the program was started again.
    // A question on a connection that has died meanwhile would never be answered.
    const signal = AbortSignal.timeout(ASKED_FOR_MS);
    const page = await fetch("/", { redirect: "manual", signal })
      .then((answer) => answer.text())
      .catch(() => "");
    if (page.includes('action="/login"')) {
      location.reload();
      return;
    }
    this.#connect();
  }

  #check() {
    if (this.#socket && Date.now() - this.#received > SILENT_AFTER_MS) {
      this.#drop();
    }
  }

  #wake() {
    if (document.visibilityState !== "visible") {
      return;
    }
    if (this.#socket) {
      this.#check();
    } else {
      this.#connect();
    }
  }

  /** Gives up a connection that says nothing any more. */
  #drop() {
    const socket = this.#socket;
    this.#onClose("");
    socket.close();
  }

  #setCondition(condition, reason) {
    this.condition = condition;
    this.reason = reason;
    this.dispatchEvent(new Event("condition"));
  }

  #send(command) {
    if (this.#socket?.readyState === WebSocket.OPEN) {
      this.#socket.send(JSON.stringify(command));
    }
  }
}

const decoder = new TextDecoder();

function decode(data, start, length = data.byteLength - start) {
  return decoder.decode(new Uint8Array(data, start, length));
}
