// What happened: how valves stood, what changed, what operators did.

import { h } from "../dom.js";
import { clock } from "../format.js";

const KINDS = { status: "state", change: "change", action: "action", link: "service" };

export function timelineView(root, { live }) {
  const list = h("ol.events"), which = h("select", { "aria-label": "Valve" }), kind = h("select", { "aria-label": "Kind" },
    h("option", { value: "" }, "everything"), Object.entries(KINDS).map(([value, text]) => h("option", { value }, text)));
  root.append(h("div.head", {}, h("h1", {}, "Time line"), h("span.fill"), h("label", {}, "Valve ", which), h("label", {}, "Kind ", kind)),
    h("section.card", {}, list));

  function fillValves() {
    const chosen = which.value;
    which.replaceChildren(h("option", { value: "" }, "all"), ...live.valves.map(({ name }) => h("option", { value: name }, name)));
    which.value = chosen;
  }

  function draw() {
    const shown = live.events.filter((event) => (!which.value || event.valve === which.value) && (!kind.value || event.kind === kind.value))
      .sort((a, b) => b.t - a.t || b.number - a.number); // what is found out late happened when it did
    list.replaceChildren(...shown.map((event) => h("li", { "data-kind": event.kind },
      h("time.muted", { datetime: new Date(event.t).toISOString() }, clock(event.t)),
      h("span", {}, h("span.badge", { "data-severity": event.severity }, KINDS[event.kind] ?? event.kind)),
      event.valve ? h("a", { href: `#/valve/${encodeURIComponent(event.valve)}` }, event.valve) : h("span.muted", {}, "service"),
      h("span", {}, event.text))));
    if (!shown.length) list.append(h("li.muted", {}, "Nothing has happened since this page began to look."));
  }

  which.addEventListener("change", draw);
  kind.addEventListener("change", draw);
  live.addEventListener("events", draw);
  live.addEventListener("layout", fillValves);
  fillValves();
  draw();
  return () => { live.removeEventListener("events", draw); live.removeEventListener("layout", fillValves); };
}
