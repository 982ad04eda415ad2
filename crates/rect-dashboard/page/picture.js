// Shows pictures as they arrive.

import { h, setText } from "./dom.js";

/** Returns an element, and `show(bytes)`, which makes it show a picture. While one is decoded, only the newest waits. */
export function pictureView() {
  const canvas = h("canvas", { role: "img", "aria-label": "Picture" });
  const problem = h("p", { class: "error" });
  const element = h("div", { class: "picture-view" }, canvas, problem);
  let isBusy = false;
  let waiting = null;

  async function show(bytes) {
    if (isBusy) {
      waiting = bytes;
      return;
    }
    isBusy = true;
    try {
      const bitmap = await createImageBitmap(new Blob([bytes]));
      draw(canvas, bitmap, bitmap.width, bitmap.height);
      setText(problem, "");
    } catch {
      setText(problem, "This picture is damaged and cannot be shown.");
    }
    isBusy = false;
    const next = waiting;
    waiting = null;
    if (next) {
      show(next);
    }
  }

  return { element, show, canvas };
}

/** Shows a bitmap or a frame of a video in its size, and releases it. */
export function draw(canvas, image, width, height) {
  canvas.width = width;
  canvas.height = height;
  canvas.getContext("2d").drawImage(image, 0, 0);
  image.close();
  canvas.hidden = false;
}
