// Over a trend: the valve's state, that of its estimate, and its alarms as lanes, alarms as shaded spans, other events as marks.

import { css, h, pen } from "./dom.js";
import { clock, REASONS, spaced } from "./format.js";
import { activeSpans, endedSpans, merged, stateSpans } from "./intervals.js";

const LANE = 18; // px
const MOST_LANES = 4; // of alarms
const INSET = 6; // px before the name of a lane
const SEVERITY = ["--good", "--note", "--warning", "--alarm"];
const FONT = "11px system-ui, sans-serif";
const SILENT = "no samples", ANSWER = "Answer";
const DOUBTS = [["ok", 0], ["partly uncertain", 1], ["uncertain", 2]]; // of an estimate: label, severity

/** `span()` is [from, to] in ms, `begin()` the first time of a value; `changes()` are the changes of alarms (`areAllKnown()`: all before the span, too), `silences()` the [from, to] without samples, `doubts()` the {from, to, doubt} of the estimator's results in the history, `statuses()` the {from, to, label, severity} of its statuses but ok; `answers()` those of the answer to the demand; `states()` those of the state, if it is in the history: the page itself knows that of a valve since its start. */
export function trendLanes({ live, valve, span, begin, changes, areAllKnown, silences, estimator, doubts, statuses, answers, states }) {
  const canvas = h("canvas.lanes", { role: "img", "aria-label": "State" });

  /** Spans of alarms of this valve and of the service; none begins before anything is known. */
  function active() {
    const [from, to] = span(), all = merged(changes(), live.alarms), first = Math.min(begin(), ...all.map(({ t }) => t));
    const spans = endedSpans(activeSpans(all, areAllKnown()), live.alarms, live.hasAllAlarms);
    return spans.map((one) => ({ ...one, from: Math.max(one.from, first) })).filter(({ source, from: a, to: b }) => (source === valve.name || source === "Service") && a < to && (b ?? Infinity) > from);
  }

  /** Events that are not alarms. */
  function marks() {
    const [from, to] = span();
    return live.events.filter(({ t, valve: of, kind }) => t >= from && t <= to && (of === valve.name || !of) && kind !== "alarm");
  }

  /** Spans of the valve's state, with its label. */
  function judged() {
    const row = live.rowOf(valve.name), old = live.oldOf(valve.name);
    const present = row ? { since: row.since, severity: row.severity, text: REASONS[row.reason][1] } : null;
    const label = (text) => REASONS.find(([, sentence]) => sentence === text)?.[0] ?? text;
    return stateSpans(live.events, valve.name, present).map((one) => ({ ...one, to: one.to ?? (old && !one.severity ? old.since : live.old ? live.old.since : null), label: label(one.text) }));
  }

  const xOf = (chart, ms) => Math.min(Math.max(chart.valToPos(ms / 1000, "x", true), chart.bbox.left), chart.bbox.left + chart.bbox.width);

  function shade(chart) {
    const { ctx } = chart, [, to] = span();
    ctx.save();
    for (const { from: a, to: b, severity, source } of active()) {
      if (source === "Service") continue; // its lane shows it
      ctx.fillStyle = `${css(SEVERITY[severity])}1c`;
      const [left, right] = [xOf(chart, a), xOf(chart, b ?? to)];
      ctx.fillRect(left, chart.bbox.top, Math.max(right - left, 1), chart.bbox.height);
    }
    ctx.restore();
  }

  function mark(chart) {
    const { ctx } = chart;
    ctx.save();
    ctx.setLineDash([2 * devicePixelRatio, 3 * devicePixelRatio]);
    for (const { t, severity } of marks()) {
      ctx.strokeStyle = css(SEVERITY[severity]);
      ctx.beginPath();
      ctx.moveTo(xOf(chart, t), chart.bbox.top);
      ctx.lineTo(xOf(chart, t), chart.bbox.top + chart.bbox.height);
      ctx.stroke();
    }
    ctx.restore();
  }

  /** Spans of the state; silences over them. */
  const stood = () => [...(states ?? judged)(), ...silences().map(([from, to]) => ({ from, to, severity: 3, label: SILENT }))];

  /** Spans of the estimate's quality; its statuses over them, which say why. */
  const estimates = () => [...doubts().map(({ from, to, doubt }) => ({ from, to, label: DOUBTS[doubt][0], severity: DOUBTS[doubt][1] })), ...statuses()];

  /** A lane for the state, one for the estimate and one for the answers where a history is kept, and one for each alarm: how long it was active. */
  function draw(chart) {
    const found = active(), laneOf = ({ source, name }) => `${source === "Service" ? "Service " : ""}${name}`;
    const kinds = [...new Set(found.map(laneOf))].slice(0, MOST_LANES), [from, to] = span();
    const isSeen = (one) => (one.to ?? to) > from && one.from < to;
    const standing = [["State", stood().filter(isSeen)], [estimator, estimates().filter(isSeen)], [ANSWER, answers().filter(isSeen)]].filter(([, spans], k) => k === 0 || spans.length);
    canvas.style.height = `${(kinds.length + standing.length) * LANE}px`;
    const { context } = pen(canvas), [left, width] = [chart.bbox.left, chart.bbox.width].map((x) => x / devicePixelRatio);
    context.font = FONT;
    context.textBaseline = "middle";
    const x = (ms) => left + width * Math.min(Math.max((ms - from) / (to - from), 0), 1);
    const bar = (lane, a, b, colour) => { context.fillStyle = colour; context.fillRect(x(a), lane * LANE + 2, Math.max(x(b) - x(a), 2), LANE - 4); };
    const written = (text, at, lane, colour, align = "left") => { context.textAlign = align; context.fillStyle = css(colour); context.fillText(text, at, (lane + 0.5) * LANE); };
    const told = ({ label, from: a, to: b }) => `${label}${a > 0 ? ` from ${clock(a)}` : ""} ${b === null ? "on" : `to ${clock(b)}`}`;
    const said = [...standing[0][1], ...found.map((one) => ({ ...one, label: spaced(laneOf(one)) }))].map(told);
    const others = standing.slice(1).map(([name, spans]) => `. ${name === ANSWER ? "Answer to the demand" : `Estimate of ${name}`}: ${spans.map(told).join("; ")}`).join("");
    canvas.setAttribute("aria-label", `State and alarms: ${said.join("; ") || "none known"}${others}`);
    standing.forEach(([name, spans], lane) => {
      written(name, left - INSET, lane, "--soft", "right");
      for (const one of spans) {
        const end = one.to ?? to;
        bar(lane, one.from, end, css(one.severity ? SEVERITY[one.severity] : "--good-ground"));
        if (x(end) - x(one.from) >= context.measureText(one.label).width + 2 * INSET) written(one.label, x(one.from) + INSET, lane, one.severity ? "--card" : "--good");
      }
    });
    for (const one of found) if (kinds.includes(laneOf(one))) bar(kinds.indexOf(laneOf(one)) + standing.length, one.from, one.to ?? to, css(SEVERITY[one.severity]));
    kinds.map(spaced).forEach((name, k) => {
      const lane = k + standing.length;
      context.fillStyle = css("--card");
      context.fillRect(left - 1, lane * LANE + 2, context.measureText(name).width + 2 * INSET, LANE - 4);
      written(name, left + INSET, lane, "--ink");
    });
  }

  return { canvas, active, marks, states: stood, shade, mark, draw };
}
