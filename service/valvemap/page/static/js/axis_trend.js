// What an axis did: its status, alarms and quantities, from the service's history.

import { shadeSpans, timeChart } from "./charts.js";
import { css, h, mark, onTheme, say } from "./dom.js";
import { clock, CODES } from "./format.js";
import { merged } from "./intervals.js";
import { readSpan, SPANS, stepOf, writeSpan } from "./spans.js";
import { trendLanes } from "./trend_lanes.js";
import { codeSpans, emptyRows, tabled } from "./trend_rows.js";
import { shown } from "./units.js";

const SERIES = [["Leakage", "Leakage", "(l/min)/bar", "--line-1"], ["BulkModulus", "Bulk modulus", "GPa", "--line-2"], ["Air", "Free air", "%", "--line-3"]]; // name, title, unit, colour
const CODED = ["Status", "Inverse.RequiredUStatus"]; // of the axis, of the answer to the demand
const REFRESH_MS = 10e3, DAY_MS = 86400e3;

export function axisTrendCard({ live, ask, name, query, keep }) {
  const state = readSpan(query), [statuses, verdicts] = CODED.map((variable) => CODES.axis[variable]);
  let rows = emptyRows(SERIES, state.span), codes = CODED.map(() => []), changes = [], isPastKnown = false;
  const to = () => state.end ?? Date.now(), from = () => to() - state.span;
  const labelled = (words) => ({ code, isPart, ...span }) => {
    const [severity, label] = words[code] ?? [1, `code ${code}`];
    return { ...span, severity, label: isPart ? `partly ${label}` : label };
  };
  const lanes = trendLanes({ live, valve: { name }, span: () => [from(), to()], begin: () => (rows.t.length ? 1000 * rows.t[0] - rows.step / 2 : Infinity), changes: () => changes, areAllKnown: () => isPastKnown,
    silences: () => rows.silences, estimator: "", doubts: () => [], statuses: () => [], states: () => codes[0].map(labelled(statuses)), answers: () => codes[1].map(labelled(verdicts)) });
  const note = h("p.words", { role: "status" }), bodies = SERIES.map(() => h("div.chart.fit"));
  const spans = h("span.segments", { role: "group", "aria-label": "Span" }, SPANS.map(([ms, text]) => h("button", { type: "button", onclick: () => go({ span: ms }) }, text)));
  const now = h("button.quiet", { type: "button", onclick: () => go({ end: null, at: null }) }, "Now");
  const element = h("section.card.stack.axis-trend", {}, h("header", {}, h("h2", {}, "What the axis did"), h("span.fill"), spans, now), lanes.canvas,
    SERIES.map(([, title, unit], k) => h("div.lane", {}, h("h3", {}, `${title} in ${shown(unit)}`), bodies[k])), note);
  const atLine = (chart) => { if (state.at !== null) shadeSpans(chart, [[state.at / 1000, state.at / 1000]], css("--ink")); };
  const drawn = SERIES.map(([label, , , colour], k) => timeChart(bodies[k], null, [{ label, colour, width: 1.5, spanGaps: true }],
    { unit: "", span: () => [from() / 1000, to() / 1000], right: 64, hooks: { drawClear: [lanes.shade, atLine], draw: k ? [lanes.mark] : [lanes.mark, lanes.draw] } }));

  function go(change) {
    Object.assign(state, change);
    keep(writeSpan(state));
    draw();
    read();
  }

  async function read() {
    const [a, b] = [from(), to()];
    const found = await ask("axis trend", live.trend(name, [...SERIES.map(([variable]) => variable), ...CODED], a, b, stepOf(state.span)));
    if (!found) return;
    if (!found.error) { rows = tabled(SERIES, found); codes = CODED.map((_, k) => codeSpans(found, SERIES.length + k)); }
    say(note, found.error ?? (found.kept ? "" : "The service keeps no history ([history] in its configuration)."));
    draw();
    const past = await ask("axis past", live.past(a - DAY_MS, Math.min(b, Date.now())));
    if (!past?.past) return;
    isPastKnown = past.kept;
    changes = merged(changes, past.past);
    draw();
  }

  function draw() {
    [...spans.children].forEach((one, k) => one.setAttribute("aria-pressed", String(SPANS[k][0] === state.span)));
    now.setAttribute("aria-pressed", String(state.end === null));
    mark(element, "past", state.end === null ? "" : `to ${clock(state.end)}`);
    const t = rows.t.length ? rows.t : [from() / 1000, to() / 1000];
    drawn.forEach(({ chart }, k) => chart.setData([t, rows.t.length ? rows.of[k][0] : [null, null]]));
  }

  const onAlarms = () => { changes = merged(changes, live.alarms); draw(); };
  live.addEventListener("alarms", onAlarms);
  const timer = setInterval(() => { if (state.end === null && !live.old) read(); }, REFRESH_MS);
  const unTheme = onTheme(draw);
  draw();
  read();
  return { element, close: () => { clearInterval(timer); unTheme(); live.removeEventListener("alarms", onAlarms); drawn.forEach(({ close }) => close()); } };
}
