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
      canvas.width = bitmap.width;
      canvas.height = bitmap.height;
      canvas.getContext("2d").drawImage(bitmap, 0, 0);
      bitmap.close();
      canvas.hidden = false;
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
