// Parts of the page for other pages: `?embed=fleet`, `?embed=camera/<robot>` or `camera/<robot>/<topic>`, and
// `?embed=plot/<robot>/<topic>`. They only show.

import { cameras } from "./cameras.js";
import { h } from "./dom.js";
import { fleet } from "./fleet.js";
import { topicPanel } from "./topic.js";

/** Shows a part in `parent`. */
export function embedded(link, parent, part) {
  const [kind, ...rest] = part.split("/");
  const name = rest.join("/");
  if (kind === "camera" && name) {
    cameras(link, parent, () => {}, name);
  } else if (kind === "plot" && rest.length > 1) {
    topicPanel(link, parent, name, { plotOnly: true });
  } else if (kind === "fleet") {
    fleet(link, parent);
  } else {
    parent.append(h("p", { class: "empty" }, "Parts are fleet, camera/<robot>, and plot/<robot>/<topic>."));
  }
}
