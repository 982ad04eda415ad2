// Decodes video with the browser's own decoder (WebCodecs), and shows it as it arrives.

import { setText } from "./dom.js";
import { draw } from "./picture.js";

/** Whether this browser decodes video. It does so only for pages of this computer, and over HTTPS. */
export const canDecode = "VideoDecoder" in globalThis;

/** The frames that wait for the decoder, at most. */
const MAX_QUEUE = 30;
/** The pause between two questions for a key frame. */
const ASK_EVERY_MS = 500;

/** Returns `show(header, bytes)`, which decodes a frame and draws it in `canvas`, and `close()`. */
export function videoView(canvas, problem, askForKey) {
  let decoder = null;
  let codec = null;
  let next = null;
  let asked = 0;

  function show(header, bytes) {
    const fits =
      next !== null && header.number === next && decoder?.state === "configured" && decoder.decodeQueueSize < MAX_QUEUE;
    if (!header.key && !fits) {
      next = null;
      ask();
      return;
    }
    if (header.key && !configure(bytes)) {
      return;
    }
    next = (header.number + 1) >>> 0;
    const type = header.key ? "key" : "delta";
    decoder.decode(new EncodedVideoChunk({ type, timestamp: header.at_ms * 1000, data: bytes }));
  }

  /** Prepares the decoder for the profile and level of a key frame. */
  function configure(bytes) {
    const name = codecOf(bytes);
    if (name === null) {
      setText(problem, "This video is damaged and cannot be shown.");
      return false;
    }
    if (decoder?.state === "configured" && codec === name) {
      return true;
    }
    close();
    decoder = new VideoDecoder({ output, error: fail });
    decoder.configure({ codec: name, optimizeForLatency: true });
    codec = name;
    return true;
  }

  function output(frame) {
    draw(canvas, frame, frame.displayWidth, frame.displayHeight);
    setText(problem, "");
  }

  function fail(error) {
    setText(problem, `This browser cannot decode the video: ${error.message}`);
    next = null;
  }

  function ask() {
    const now = performance.now();
    if (now - asked >= ASK_EVERY_MS) {
      asked = now;
      askForKey();
    }
  }

  function close() {
    if (decoder && decoder.state !== "closed") {
      decoder.close();
    }
  }

  return { show, close };
}

/** Returns the name of the codec with its profile and level, from the parameters of the sequence. */
function codecOf(bytes) {
  for (let at = 0; at + 6 < bytes.length; at += 1) {
    const isStart = bytes[at] === 0 && bytes[at + 1] === 0 && bytes[at + 2] === 1;
    if (isStart && (bytes[at + 3] & 0x1f) === 7) {
      const digits = [...bytes.subarray(at + 4, at + 7)].map((byte) => byte.toString(16).padStart(2, "0"));
      return `avc1.${digits.join("")}`;
    }
  }
  return null;
}
