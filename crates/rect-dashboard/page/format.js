// Formats figures with their units.

/** Returns a number of bytes, such as `1.2 kB`. */
export function bytes(count) {
  if (count === null || count === undefined) {
    return "–";
  }
  const units = ["B", "kB", "MB", "GB", "TB"];
  let unit = 0;
  let value = count;
  while (value >= 1000 && unit < units.length - 1) {
    value /= 1000;
    unit += 1;
  }
  return `${unit === 0 ? Math.round(value) : value.toPrecision(value < 10 ? 2 : 3)} ${units[unit]}`;
}

/** Returns a rate, such as `9.8 Hz`. */
export function hertz(rate) {
  return `${rate.toFixed(rate < 100 ? 1 : 0)} Hz`;
}

/** Returns a time in milliseconds, such as `12 ms` or `3.4 s`. */
export function milliseconds(ms) {
  if (ms === null || ms === undefined) {
    return "–";
  }
  if (ms >= 1000) {
    return seconds(ms / 1000);
  }
  return `${ms < 10 ? ms.toFixed(1) : Math.round(ms)} ms`;
}

/** Returns a duration, such as `3.4 s`, `5 min` or `2 h`. */
export function seconds(s) {
  if (s === null || s === undefined) {
    return "–";
  }
  if (s < 10) {
    return `${s.toFixed(1)} s`;
  }
  if (s < 120) {
    return `${Math.round(s)} s`;
  }
  return s < 7200 ? `${Math.round(s / 60)} min` : `${Math.round(s / 3600)} h`;
}

function two(digits) {
  return String(digits).padStart(2, "0");
}

/** Returns the time of day of a time since 1970. */
export function timeOfDay(ms) {
  const time = new Date(ms);
  return `${two(time.getHours())}:${two(time.getMinutes())}:${two(time.getSeconds())}`;
}

/** Returns a number with up to six significant digits. */
export function number(value) {
  return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(6)));
}

// Characters that change the direction of text, control characters, and those that cannot be seen.
const HIDDEN = /[\u0000-\u0008\u000b-\u001f\u007f-\u009f\u00ad\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff]/g;

/** Returns a text of a robot, at most `limit` characters, with its hidden characters visible. */
export function visible(text, limit = 200) {
  const shown = text.length > limit ? `${text.slice(0, limit)}… (${text.length} characters)` : text;
  return shown.replace(HIDDEN, "\u2423");
}

/** Returns the method, and the path that carries the load if there are several. */
export function pathText({ method, paths }) {
  const primary = paths?.find((path) => path.is_primary);
  const others = paths?.filter((path) => !path.is_primary).map((path) => `${path.method} ${path.state}`);
  return primary ? `${primary.method}${others.length ? ` (${others.join(", ")})` : ""}` : method;
}
