// What happened: how valves stood, what changed, what operators did.

import { h } from "../dom.js";
import { clock, KINDS, spaced } from "../format.js";
import { inUnits } from "../units.js";

const PAST_MS = 7 * 86400e3;

export function timelineView(root, { live, ask }) {
  const list = h("ol.events"), which = h("select", { "aria-label": "Valve" }), kind = h("select", { "aria-label": "Kind" },
    h("option", { value: "" }, "everything"), Object.entries(KINDS).map(([value, text]) => h("option", { value }, text)));
  root.append(h("div.head", {}, h("h1", {}, "Time line"), h("span.fill"), h("label", {}, "Valve ", which), h("label", {}, "Kind ", kind)),
    h("section.card", {}, list));

  function fillValves() {
    const chosen = which.value;
    which.replaceChildren(h("option", { value: "" }, "all"), ...live.valves.map(({ name }) => h("option", { value: name }, name)));
    which.value = chosen;
  }

  let past = [], unread = "";

  /** Alarms from before this page began to look, from the service's history. */
  async function readPast() {
    const found = await ask("past", live.past(Date.now() - PAST_MS, Date.now()));
    if (!found) return;
    unread = found.error ?? "";
    if (unread) { draw(); return; }
    const events = (found.past ?? []).map(({ t, source, name, text, severity, active, acked, event }) => ({
      number: -1, t, valve: source === "Service" ? "" : source, kind: "alarm", severity: active && !acked ? severity : 1, event,
      text: `${spaced(name)} ${active ? (acked ? "acknowledged; still active" : "raised") : acked ? "acknowledged" : "cleared"}. ${text}`,
    }));
    past = events.sort((a, b) => b.t - a.t);
    draw();
  }

  function draw() {
    const first = Math.min(...live.events.filter((event) => event.kind === "alarm").map(({ t }) => t), Infinity);
    const shown = [...live.events, ...past.filter(({ t }) => t < first)].filter((event) => (!which.value || event.valve === which.value) && (!kind.value || event.kind === kind.value))
      .sort((a, b) => b.t - a.t || b.number - a.number); // what is found out late happened when it did
    list.replaceChildren(...shown.map((event) => h("li", { "data-kind": event.kind },
      h("time.muted", { datetime: new Date(event.t).toISOString() }, clock(event.t)),
      h("span", {}, h("span.badge", { "data-severity": event.severity }, KINDS[event.kind] ?? event.kind)),
      event.valve ? h("a", { href: live.hrefOf(event.valve) }, event.valve) : h("span.muted", {}, "service"),
      h("span", {}, inUnits(event.text)))));
    if (unread) list.prepend(h("li.muted", {}, `What happened before this page began to look was not read: ${unread}`));
    else if (!shown.length) list.append(h("li.muted", {}, "Nothing has happened since this page began to look."));
  }

  which.addEventListener("change", draw);
  kind.addEventListener("change", draw);
  live.addEventListener("events", draw);
  live.addEventListener("layout", fillValves);
  const again = () => { if (!live.old) readPast(); };
  live.addEventListener("standing", again);
  fillValves();
  draw();
  readPast();
  return () => { live.removeEventListener("events", draw); live.removeEventListener("layout", fillValves); live.removeEventListener("standing", again); };
}
