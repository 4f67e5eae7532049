// What the signals of a valve did: from the service's history, live data on top.

import { shadeSpans, timeChart } from "../charts.js";
import { css, h, mark, onTheme, say } from "../dom.js";
import { clock, fixed, INVERSE_STATUS, KINDS, NAN, span as spanText, spaced, STATUS } from "../format.js";
import { merged } from "../intervals.js";
import { operatingPoints } from "../operating_points.js";
import { bounded, isFromAfar, readSpan, SPANS, stepOf, writeSpan } from "../spans.js";
import { trendLanes } from "../trend_lanes.js";
import { addNewest, codeSpans, doubtSpans, emptyRows, joined, pointsOf, tabled } from "../trend_rows.js";
import { told } from "../trust.js";
import { decimals, inUnits, shown } from "../units.js";

const REFRESH_MS = 30000; // what is live is read again so often, from the history,
const PER_INTERVAL = 10; // and no more often than so many times an interval;
const TORN_MS = 5000; // sooner where the history was behind
const ASK_MS = 250; // between two reads while zooming
const CURSOR_STEPS = 60; // over a span
const DAY_MS = 86400e3;
const BEFORE = [[0, "nothing"], [3600e3, "an hour before"], [86400e3, "a day before"], [7 * 86400e3, "a week before"]];

export function trendView(root, { live, ask, valve, query, keep }) {
  const closers = [], state = readSpan(query), estimator = live.get("Recommended")?.value || valve.primary;
  const SERIES = [ // name, caption, unit, colour, spread
    ["Signals.Q", "Q", "l/min", "--measured"], [`${estimator}.PredictedFlow`, "Q̂", "l/min", "--line-1"],
    [`${estimator}.Residual`, "Q − Q̂", "l/min", "--line-1", true], [`${estimator}.NoiseStd`, "Noise", "l/min", "--line-6", true],
    ["Signals.U", "U", "%", "--line-1"], ["Signals.T", "T", "°C", "--line-2"],
    ["Signals.p1", "p₁", "bar", "--line-1"], ["Signals.p2", "p₂", "bar", "--line-2"], ["Signals.dp", "Δp", "bar", "--line-3"],
  ];
  const CODES = [`${estimator}.Status`, "Inverse.RequiredUStatus"]; // of the estimate, of the answer to the demand
  const names = SERIES.map(([name]) => name), PREDICTED = 1, U = 4, DP = 8;
  let rows = emptyRows(SERIES, state.span), doubts = [], codes = CODES.map(() => []), others = null, changes = [], timer = 0, readAt = -Infinity, isReading = false, isBehind = false, pastFrom = Infinity, isPastKnown = false, failed = "", source = null, hover = null;
  const comparedWith = []; // what the dashed line is, in each legend

  const title = h("h1", {}, `${valve.name}: trend`), badge = h("span.badge"), note = h("span.muted.sentence", { role: "status" });
  const spans = h("span.segments", { role: "group", "aria-label": "Span" }, SPANS.map(([ms, text]) => h("button", { type: "button", "data-span": ms, onclick: () => go({ span: ms }) }, text)));
  const button = (text, label, act) => h("button.quiet", { type: "button", "aria-label": label, title: label, onclick: act }, text);
  const now = button("Now", "Now: follow the newest data (N)", () => go({ end: null, at: null }));
  const moves = h("span.together", {}, button("◀", "◀ earlier (←)", () => pan(-0.5)), button("▶", "▶ later (→)", () => pan(0.5)), button("+", "+ zoom in", () => zoom(0.5)), button("−", "− zoom out", () => zoom(2)), now);
  const otherValve = h("select", { "aria-label": "Compare with valve", onchange: () => go({ other: otherValve.value }) },
    h("option", { value: "" }, "no other valve"), live.valves.filter(({ name, kind }) => name !== valve.name && !kind).map(({ name }) => h("option", { value: name, selected: name === state.other }, name)));
  const before = h("select", { "aria-label": "Compare with time", onchange: () => go({ before: Number(before.value) }) }, BEFORE.map(([ms, text]) => h("option", { value: ms, selected: ms === state.before }, text)));
  const lanes = trendLanes({ live, valve, span: () => [from(), to()], begin: () => (rows.t.length ? 1000 * rows.t[0] - rows.step / 2 : Infinity), changes: () => changes, areAllKnown: () => isPastKnown, silences: () => rows.silences, estimator, doubts: () => doubts,
    statuses: () => codes[0].filter(({ code }) => code).map(worded(STATUS, ([label, , severity]) => [label, severity])), answers: () => codes[1].filter(({ code }) => INVERSE_STATUS[code]?.[3] ?? true).map(worded(INVERSE_STATUS, ([severity, , label]) => [label, severity])) });
  function worded(words, parts) {
    return ({ from: a, to: b, code, isPart }) => {
      const [label, severity] = words[code] ? parts(words[code]) : [`code ${code}`, 1];
      return { from: a, to: b, label: isPart ? `partly ${label}` : label, severity };
    };
  }
  const charts = [["Flow", [0, 1]], ["Residual Q − Q̂", [2]], ["Control voltage and oil temperature", [4, 5]], ["Pressures", [6, 7, 8]]];
  const bodies = charts.map(() => h("div.chart.fit"));
  const readout = h("tbody"), when = h("h2"), list = h("ol.marks"), points = operatingPoints();
  closers.push(points.close);

  root.append(
    h("div.head", {}, title, badge, note, h("span.fill"), h("label", {}, "Compare ", live.valves.length > 1 ? otherValve : null, before)),
    h("div.head", {}, spans, moves),
    h("div.trend-grid", {},
      h("section.card.stack", { "aria-label": "Charts" }, lanes.canvas, charts.map(([name, of], k) => h("div.lane", {}, h("header", {}, h("h2", {}, name), h("span.fill"), legend(of)), bodies[k]))),
      h("div.side", {},
        h("section.card", {}, h("header", {}, when), h("table.readout", {}, h("thead", {}, h("tr", {}, h("th", {}, "Signal"), h("th.number", {}, "Value"), h("th.number", {}, "Least"), h("th.number", {}, "Largest"))), readout)),
        points.element,
        h("section.card.grow", {}, h("header", {}, h("h2", {}, "What happened in this span")), list)),
    ),
  );
  SERIES.forEach(([, caption, unit, colour]) => readout.append(h("tr", {}, h("td", {}, h("i.swatch", { style: { "--c": `var(${colour})` } }), caption, h("small.muted", {}, ` ${shown(unit)}`)), h("td.number.value"), h("td.number"), h("td.number"))));

  function legend(of) {
    const words = h("span"), entry = h("span", {}, h("i.dashed", { style: { "--c": "var(--line-5)" } }), words);
    comparedWith.push([entry, words]);
    return h("div.legend", {}, of.map((k) => h("span", {}, h("i", { style: { "--c": `var(${SERIES[k][3]})` } }), SERIES[k][1])), entry);
  }

  const range = () => [from() / 1000, to() / 1000];
  const to = () => state.end ?? Date.now(), from = () => to() - state.span;
  const cursor = { sync: { key: `trend-${valve.name}` }, drag: { x: true, y: false, setScale: false }, bind: { dblclick: () => null } };
  const hooks = {
    drawClear: [lanes.shade, (chart) => { if (state.at !== null) shadeSpans(chart, [[state.at / 1000, state.at / 1000]], css("--ink")); }], draw: [lanes.mark],
    setCursor: [(chart) => { const t = chart.cursor.left >= 0 ? chart.posToVal(chart.cursor.left, "x") : null; if (t !== hover) { hover = t; showReadout(); } }],
    setSelect: [(chart) => {
      if (chart.select.width < 5) return;
      const [a, b] = [chart.select.left, chart.select.left + chart.select.width].map((x) => 1000 * chart.posToVal(x, "x"));
      chart.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
      go({ span: bounded(b - a), end: b });
    }],
  };
  const plain = (label, colour, more = {}) => ({ label, colour, ...more });
  const spread = (label, colour, more = {}) => [plain(`${label} largest`, colour, { ...more, width: 0 }), plain(`${label} least`, colour, { ...more, width: 0 }), plain(label, colour, more)];
  const compare = (more = {}) => plain("compared", "--line-5", { width: 1.25, dash: [4, 4], ...more });
  const options = (unit, more = {}) => ({ unit, cursor, hooks, span: range, ...more });
  const drawn = [
    timeChart(bodies[0], null, [...spread("Q", "--measured", { width: 1.25 }), plain("Q̂ upper", "--line-1", { width: 0 }), plain("Q̂ lower", "--line-1", { width: 0 }), plain("Q̂", "--line-1"), compare()],
      options(`Q in ${shown("l/min")}`, { hooks: { ...hooks, draw: [lanes.mark, lanes.draw] }, bands: [[1, 2, "--measured", "30"], [4, 5, "--line-1"]], right: 64 })),
    timeChart(bodies[1], null, [...spread("residual", "--line-1"), plain("+2σ", "--line-6", { width: 0 }), plain("−2σ", "--line-6", { width: 0 }), compare()],
      options(shown("l/min"), { bands: [[1, 2, "--line-1", "40"], [4, 5, "--line-6"]], right: 64 })),
    timeChart(bodies[2], null, [...spread("U", "--line-1"), plain("T", "--line-2", { scale: "second" }), compare()], options("U in %", { unit2: `T in ${shown("°C")}`, bands: [[1, 2, "--line-1", "40"]] })),
    timeChart(bodies[3], null, [...spread("p₁", "--line-1"), ...spread("p₂", "--line-2"), ...spread("Δp", "--line-3"), compare()],
      options(shown("bar"), { bands: [[1, 2, "--line-1", "40"], [4, 5, "--line-2", "40"], [7, 8, "--line-3", "40"]], right: 64 })),
  ];
  closers.push(...drawn.map(({ close }) => close));

  function go(change) {
    Object.assign(state, change);
    if (state.end !== null && state.end > Date.now()) state.end = null;
    keep(writeSpan(state));
    live.watch(valve.name, null, isFromAfar(state.span));
    draw();
    readSoon();
  }
  /** The values at another time, by keyboard; in view. */
  const step = (count) => {
    const wanted = (state.at ?? to()) + count * Math.max(stepOf(state.span), state.span / CURSOR_STEPS);
    const at = Math.min(wanted, Date.now());
    go({ at, end: at < from() || at > to() ? at + state.span / 2 : state.end });
  };
  const pan = (share) => go({ end: to() + share * state.span });
  const zoom = (factor, around = state.end === null ? to() : to() - state.span / 2) => {
    const span = bounded(state.span * factor), share = (to() - around) / state.span;
    go({ span, end: state.end === null && share === 0 ? null : around + share * span });
  };

  /** One read at a time, and no more often than the page's server takes questions. */
  function readSoon() {
    clearTimeout(timer);
    timer = setTimeout(read, Math.max(readAt + ASK_MS - performance.now(), 0));
  }

  async function read() {
    if (isReading) { isBehind = true; return; }
    [isReading, isBehind, readAt] = [true, false, performance.now()];
    mark(root, "reading", true);
    const [a, b] = [from(), to()], step = stepOf(state.span), { other: otherName, before: otherAt } = state;
    const otherOf = live.valves.find(({ name }) => name === otherName)?.primary ?? estimator;
    const wanted = ask("trend", live.trend(valve.name, [...names, ...CODES], a, b, step));
    const compared = otherName || otherAt ? ask("compared", live.trend(otherName || valve.name, names.map((name) => (otherName ? name.replace(estimator, otherOf) : name)), a - otherAt, b - otherAt, step)) : null;
    const found = await wanted, other = await compared;
    isReading = false;
    if (!found) return;
    failed = found.error ?? "";
    if (!found.error) { rows = tabled(SERIES, found); doubts = found.kept ? doubtSpans(found, PREDICTED) : []; codes = CODES.map((_, k) => codeSpans(found, names.length + k)); source = { kept: found.kept, since: found.since }; }
    const isSame = otherName === state.other && otherAt === state.before; // else another read follows
    others = other && !other.error && isSame ? tabled(SERIES, other, otherAt) : null;
    mark(root, "compared", others ? otherName || "before" : "");
    draw();
    mark(root, "reading", false);
    readPast();
    if (isBehind) readSoon();
  }

  /** Changes of alarms from a day before the span on: what was active when it begins. */
  async function readPast() {
    const first = from() - DAY_MS, last = Math.min(pastFrom, Date.now());
    if (first >= pastFrom) return;
    pastFrom = first;
    const found = await ask("past", live.past(first, last));
    if (!found) return;
    isPastKnown = Boolean(found.past && found.kept);
    if (found.past) changes = merged(changes, found.past);
    else pastFrom = Infinity; // asked again with the next read
    draw();
  }

  /** The newest values, in intervals like those read; the first one that comes may be from before this view. */
  function addLive() {
    if (state.end !== null || live.oldOf(valve.name)) return;
    const at = live.get(`${estimator}.PredictedFlow`)?.t || live.get("Signals.U")?.t || 0;
    if (!rows.newest) { rows.newest = at; return; }
    const values = names.map((name) => {
      const value = live.number(name);
      return name === "Signals.Q" && Number.isNaN(value) ? live.number(`${estimator}.PredictedFlow`) + live.number(`${estimator}.Residual`) : value;
    });
    addNewest(rows, SERIES, values, at);
  }

  const wide = (c) => [rows.of[c][2], rows.of[c][1], rows.of[c][0]];
  const off = (values, noise, sign, times) => values.map((value, k) => (value === null || noise[k] === null ? null : value + sign * times * noise[k]));

  function draw() {
    for (const one of spans.children) one.setAttribute("aria-pressed", String(Number(one.dataset.span) === state.span));
    now.setAttribute("aria-pressed", String(state.end === null));
    for (const [entry, words] of comparedWith) {
      entry.hidden = !state.other && !state.before;
      say(words, [state.other, state.before && BEFORE.find(([ms]) => ms === state.before)?.[1]].filter(Boolean).join(", "));
    }
    const noise = rows.of[3][0], zero = rows.of[2][0].map((value) => (value === null ? null : 0));
    const data = [
      [...wide(0), off(rows.of[1][0], noise, 1, 1.96), off(rows.of[1][0], noise, -1, 1.96), rows.of[1][0]],
      [...wide(2), off(zero, noise, 1, 2), off(zero, noise, -1, 2)],
      [...wide(4), rows.of[5][0]],
      [...wide(6), ...wide(7), ...wide(8)],
    ];
    const compared = [0, 2, 4, 8].map((c) => others?.of[c][0]);
    const bare = rows.t.length ? null : [from() / 1000, to() / 1000]; // the axes of time, and the bands
    drawn.forEach(({ chart }, k) => chart.setData(bare ? [bare, ...chart.series.slice(1).map(() => [null, null])] : joined(rows.t, data[k], others?.t, compared[k])));
    points.draw(pointsOf(rows, [U, DP], doubts, [from(), to()]));
    showReadout();
    showStanding();
    showMarks();
  }

  function showReadout() {
    const at = hover ?? (state.at === null ? null : state.at / 1000);
    let k = rows.t.length - 1;
    if (at !== null) { k = 0; while (k < rows.t.length - 1 && rows.t[k + 1] - at < at - rows.t[k]) k++; }
    const isNew = at === null && state.end === null && !live.oldOf(valve.name);
    say(when, at !== null && rows.t.length ? `At ${clock(rows.t[k] * 1000)}` : isNew ? "Newest" : rows.t.length ? `Last, ${clock(rows.t[k] * 1000)}` : "No values");
    SERIES.forEach(([, , unit], c) => {
      const { cells } = readout.rows[c], digits = decimals(unit, unit === "l/min" && c > 1 ? 2 : 1);
      const value = (j) => (rows.t.length ? fixed(rows.of[c][j][k] ?? NaN, digits) : NAN);
      say(cells[1], value(0));
      const inView = at === null ? rows.t.map((t, i) => (t * 1000 >= from() ? i : -1)).filter((i) => i >= 0) : [k];
      const numbers = (j) => inView.map((i) => rows.of[c][j][i]).filter((v) => v !== null);
      say(cells[2], fixed(numbers(1).reduce((a, b) => Math.min(a, b), Infinity), digits));
      say(cells[3], fixed(numbers(2).reduce((a, b) => Math.max(a, b), -Infinity), digits));
    });
  }

  function showStanding() {
    const old = live.oldOf(valve.name), step = rows.step / 1000;
    mark(root, "stale", old !== null && (state.end === null || live.old !== null));
    mark(badge, "severity", old ? 3 : state.end === null ? 0 : 1);
    say(badge, old ? "not live" : state.end === null ? "live" : "past");
    const read = !source ? "Reading the service's history …" : source.kept === false
      ? `The service keeps no history ([history] in its configuration). Shown is what this page has seen${source.since ? ` since ${clock(source.since)}` : ""}.`
      : `${clock(from())} to ${clock(to())}. Mean, least and largest of ${step < 1 ? `${rows.step} ms` : spanText(step)} each, from the service's history.`;
    say(note, failed ? `Not read: ${failed}` : old ? told(old) : read);
  }

  function showMarks() {
    const found = [
      ...lanes.active().map(({ from: a, to: b, severity, name, text, source: of, raised }) => ({ t: a, severity, head: `${of === "Service" ? "Service: " : ""}${spaced(name)}`, text: `${b === null ? "active" : a > 0 && b > a ? `${spanText((b - a) / 1000)} long` : `until ${clock(b)}`}. ${text.split(" It may be: ")[0]}`, href: `#/alarms?alarm=${encodeURIComponent(`${of}/${raised.name}`)}` })),
      ...lanes.marks().map(({ t, severity, text, kind }) => ({ t, severity, head: KINDS[kind] ?? kind, text })),
    ].sort((a, b) => b.t - a.t).slice(0, 60);
    const key = JSON.stringify(found);
    if (list.dataset.key === key) return;
    list.dataset.key = key;
    list.replaceChildren(...found.map(({ t, severity, head, text, href }) => h("li", {},
      h("span.badge", { "data-severity": severity }, head), h("time.muted", {}, t > 0 ? clock(t) : "before"), h("p", {}, inUnits(text)), href ? h("a", { href }, "Alarm") : null)));
    if (!found.length) list.append(h("li.muted", {}, `No alarm or event in these ${spanText(state.span / 1000)}.`));
  }

  function onKey(event) {
    if (event.target.matches?.("input, select, textarea") || event.ctrlKey || event.metaKey || event.altKey) return;
    const act = { ArrowLeft: () => pan(-0.25), ArrowRight: () => pan(0.25), "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), n: () => go({ end: null, at: null }) }[event.key];
    const move = event.shiftKey ? { ArrowLeft: () => step(-1), ArrowRight: () => step(1) }[event.key] : null;
    if (move) { event.preventDefault(); move(); return; }
    if (act) { event.preventDefault(); act(); }
  }
  function onWheel(event) {
    event.preventDefault();
    const { chart } = drawn[0], box = chart.over.getBoundingClientRect(), share = Math.min(Math.max((event.clientX - box.left) / box.width, 0), 1);
    if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) pan(Math.sign(event.deltaX || event.deltaY) * 0.15);
    else zoom(event.deltaY > 0 ? 1.4 : 1 / 1.4, from() + share * state.span);
  }
  const stack = root.querySelector(".stack");
  stack.addEventListener("wheel", onWheel, { passive: false });
  document.addEventListener("keydown", onKey);
  const onAlarms = () => { changes = merged(changes, live.alarms); draw(); };
  live.addEventListener("values", addLive);
  live.addEventListener("alarms", onAlarms);
  let wasOld = live.old;
  const onStanding = () => { if (wasOld && !live.old) read(); wasOld = live.old; draw(); };
  live.addEventListener("standing", onStanding);
  const refreshMs = () => (rows.isTorn ? TORN_MS : Math.max(REFRESH_MS, stepOf(state.span) / PER_INTERVAL));
  const pace = () => Math.min(Math.max(stepOf(state.span) / 2, 250), 5000);
  let tick = setTimeout(function again() {
    if (state.end === null) { draw(); if (performance.now() - readAt > refreshMs() && !live.old) read(); }
    tick = setTimeout(again, pace());
  }, 250);
  closers.push(() => clearTimeout(tick), () => clearTimeout(timer), () => document.removeEventListener("keydown", onKey),
    () => live.removeEventListener("values", addLive), () => live.removeEventListener("alarms", onAlarms), () => live.removeEventListener("standing", onStanding), onTheme(draw));
  keep(writeSpan(state));
  draw();
  read();
  return () => closers.forEach((close) => close());
}
