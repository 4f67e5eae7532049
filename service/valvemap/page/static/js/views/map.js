// The map of one valve: surface, how sure it is where, a section, and which voltage a flow demands.

import { lineChart, shadeSpans } from "../charts.js";
import { css, h, mark, onTheme, say } from "../dom.js";
import { clock, counted, fixed, inUnit, spreadInUnit } from "../format.js";
import { inverseCard } from "../inverse_card.js";
import { slider } from "../slider.js";
import { standingOf } from "../trust.js";
import { approvedCard } from "./approved_card.js";
import { decimals, inUnits, shown, spreadShown, toShown } from "../units.js";

const COLOURINGS = [
  ["Q", "Flow"], ["std", "Uncertainty"], ["status", "Extrapolated"], ["change", "Difference"],
];
const EXTRAPOLATING = 6;
const LIFT = 0.004; // of the largest flow: neither sheet shines through the other
const NEAR_BAR = 10; // points so near to a section are drawn on it
const AROUND_MS = 3000; // before an alarm, for the place where it arose

export function mapView(root, { live, ask, valve, estimator, isChosen, choose, user, query }) {
  const closers = [];
  let colouring = "Q", kept = null, guessed = [], isDrawing = false, isBehind = false, plotted = null, section = 100, redraw = 0;
  let selected = estimator, place = null;

  const which = h("select", { "aria-label": "Estimator", onchange: () => { isChosen = true; select(which.value); } },
    valve.estimators.map((name) => h("option", { value: name, selected: name === selected }, name)));
  const colourings = h("span.segments", { role: "group", "aria-label": "Colour by" }, COLOURINGS.map(([key, title]) =>
    h("button", { type: "button", "data-colouring": key, "aria-pressed": String(key === colouring), onclick: () => { colouring = key; schedule(true); } }, title)));
  const keep = h("button.quiet", { type: "button", onclick: () => { kept = surface(); keepButton(); if (kept) colouring = "change"; schedule(true); } }, "Keep to compare");
  const plot = h("div.surface", { role: "img", "aria-label": "Flow over control voltage and pressure drop" });
  const words = h("p.words"), badge = h("span.badge"), sentence = h("span.muted.sentence");
  const sectionChart = h("div.chart"), sectionWords = h("span.muted");
  const best = h("strong"), reason = h("p"), placeWords = h("p.words");
  const approved = approvedCard({ live, ask, user, valve, onShow: () => { kept = null; keepButton(); colouring = "change"; schedule(true); } });
  const sectionSlider = slider("Pressure drop", "bar", 0, 200, 1, section, (value) => { section = value; drawSection(); schedule(); });
  const inverse = inverseCard({
    live, ask, user, name: valve.name, title: "Which U for which flow?", quantity: "FlowDemand",
    sliders: [slider("Flow", "l/min", 0, 200, 0.5, 60), slider("Pressure drop", "bar", 1, 200, 1, 100)],
    question: ([flow, dp]) => live.invert(valve.name, flow, dp),
    demand: ([flow, dp]) => ({ demand: valve.name, Q: flow, dp }),
    words: ([flow, dp]) => `${inUnit(flow, "l/min", 1)} ${shown("l/min")} at ${inUnit(dp, "bar", 0)} ${shown("bar")}`,
    inForce: () => [live.number("Inverse.FlowDemand"), live.number("Inverse.PressureDrop")],
  });

  root.append(
    h("div.head", {}, h("h1", {}, `${valve.name}: map`), badge, sentence, h("span.fill"), h("span.together", {}, h("span.muted", {}, "Colour"), colourings), keep),
    h("div.grid.map-grid", {},
      h("section.card.stack", {}, plot, placeWords, words),
      h("div.grid", {},
        h("section.card.best", {}, h("header", {}, h("h2", {}, "Recommended map"), best), reason,
          h("details.diagnostics", {}, h("summary", {}, "Diagnostics: the map of another estimator"), h("label", {}, "Estimator ", which))),
        inverse.element,
        h("section.card", {},
          h("header", {}, h("h2", {}, "Section at one pressure drop"), h("span.fill"), sectionWords),
          sectionChart, sectionSlider.element),
        approved.element,
      ),
    ),
  );

  const chart = lineChart(sectionChart, 220, [
    { label: "upper", colour: "--line-1", width: 0 }, { label: "lower", colour: "--line-1", width: 0 },
    { label: "Q̂", colour: "--line-1", width: 2 }, { label: "kept", colour: "--line-6", width: 1.5, dash: [5, 4] },
    { label: "measured", colour: "--measured", points: true },
  ], { x: "U in %", y: `Q in ${shown("l/min")}`, bands: [[1, 2, "--line-1"]], xRange: [0, 100], hooks: { drawClear: [(drawn) => shadeSpans(drawn, guessed, css("--line"))] } });
  closers.push(chart.close);

  function select(name) {
    selected = name;
    which.value = name;
    kept = null;
    choose(selected);
    keepButton();
    approved.select(selected);
  }

  /** The recommended map is shown, unless another one was chosen. */
  function followRecommended() {
    const recommended = live.get("Recommended")?.value, why = live.get("RecommendedReason")?.value, of = live.oldOf(valve.name);
    if (!isChosen && recommended && recommended !== selected && valve.estimators.includes(recommended)) select(recommended);
    say(best, of ? "not known now" : recommended ? (recommended === selected ? recommended : `${recommended} (shown: ${selected})`) : `none yet (shown: ${selected})`);
    say(reason, inUnits(why || "No estimator stands out yet: places must be visited again."));
  }

  /** Where the valve worked when an alarm arose. */
  async function findPlace() {
    const at = Number(query.get("at"));
    if (!(at > 0)) return;
    const found = await ask("place", live.trend(valve.name, ["Signals.U", "Signals.dp", "Signals.Q"], at - AROUND_MS, at + 500, 500));
    if (!found) return;
    const rows = found.error ? [] : [...found.courses[0][0]].map((_, k) => found.courses.map(([mean]) => mean[k])).filter((row) => row.every(Number.isFinite));
    if (!rows.length) { say(placeWords, `Where the valve worked at ${clock(at)} is not kept.`); return; }
    const [U, dp, flow] = rows.at(-1);
    place = { U, dp, Q: flow };
    section = Math.round(dp);
    sectionSlider.set(section);
    say(placeWords, `At ${clock(at)} the valve worked at U ${fixed(U, 1)} %, Δp ${inUnit(dp, "bar", 0)} ${shown("bar")}, Q ${inUnit(flow, "l/min", 1)} ${shown("l/min")} (marked).`);
    schedule(true);
  }

  function keepButton() { say(keep, kept ? "Keep again" : "Keep to compare"); }

  /** The newest surface, all in one. */
  function surface(kind = "Surface") {
    const of = (name) => live.get(`${selected}.${kind}${name}`)?.value;
    const [U, Dp, flow, std, status] = ["U", "Dp", "Q", "Std", "Status"].map(of);
    return U && Dp && flow && std && status ? { U: [...U], dp: [...Dp], Q: flow.map((row) => [...row]), std: std.map((row) => [...row]), status: status.map((row) => [...row]) } : null;
  }

  /** With which map the present one is compared: kept here, else the approved one. */
  function before() { return kept ?? (live.get("Baseline.Version")?.value ? surface("Approved") : null); }

  function schedule(now = false) {
    for (const button of colourings.children) {
      const pressed = String(button.dataset.colouring === colouring);
      if (button.getAttribute("aria-pressed") !== pressed) button.setAttribute("aria-pressed", pressed);
    }
    clearTimeout(redraw);
    redraw = setTimeout(() => { draw(); drawSection(); }, now ? 0 : 60);
  }

  /** One drawing at a time: a slow machine would begin the next one before the surface is set up. */
  async function draw() {
    if (isDrawing) { isBehind = true; return; }
    [isDrawing, isBehind] = [true, false];
    try { await drawSurface(); } finally { isDrawing = false; }
    if (isBehind && ask.isOpen()) schedule();
  }

  async function drawSurface() {
    const Plotly = surface() && await ask("surface", plotly()), found = surface();
    if (!found) { say(words, "The service is being asked for the map …"); return; }
    if (!Plotly) return;
    const colour = colours(found);
    const points = live.get("Points")?.value ?? [];
    const rows = Array.isArray(points) ? points : [points];
    const hovertemplate = `U %{y:.1f} %<br>Δp %{x:.${decimals("bar", 0)}f} ${shown("bar")}<br>Q %{z:.${decimals("l/min", 1)}f} ${shown("l/min")}<extra></extra>`;
    const beyond = colouring === "status" ? [] : extrapolated(found);
    const traces = [
      {
        type: "surface", x: found.dp.map(bar), y: found.U, z: found.Q.map((row) => row.map(lpm)), surfacecolor: colour.values, colorscale: colour.scale, cmin: colour.low, cmax: colour.high,
        colorbar: { title: { text: colour.title, side: "top" }, thickness: 12, len: 0.75, tickfont: { color: css("--soft") }, ...colour.ticks }, opacity: 0.96,
        hovertemplate, showscale: true,
      },
      { type: "surface", x: found.dp.map(bar), y: found.U, z: beyond.map((row) => row.map(lpm)), colorscale: [[0, css("--far")], [1, css("--far")]], opacity: 0.96, hovertemplate, showscale: false },
      {
        type: "scatter3d", mode: "markers", x: rows.map((r) => bar(r[1])), y: rows.map((r) => r[0]), z: rows.map((r) => lpm(r[2])),
        marker: { size: 2.4, color: css("--measured"), opacity: 0.75 }, hoverinfo: "skip", showlegend: false,
      },
      {
        type: "scatter3d", mode: "lines", x: found.U.map(() => bar(section)), y: found.U, z: found.Q.map((row) => lpm(interpolate(found.dp, row, section))),
        line: { color: css("--ink"), width: 4 }, hoverinfo: "skip", showlegend: false,
      },
      ...(place ? [{
        type: "scatter3d", mode: "markers", x: [bar(place.dp)], y: [place.U], z: [lpm(place.Q)], hoverinfo: "skip", showlegend: false,
        marker: { size: 7, color: css("--alarm"), line: { color: css("--card"), width: 2 }, symbol: "diamond" },
      }] : []),
    ];
    const then = colouring === "change" ? before() : null;
    if (then) { // both maps: the earlier one as a faint sheet
      traces.push({ type: "surface", x: then.dp.map(bar), y: then.U, z: then.Q.map((row) => row.map(lpm)), opacity: 0.32, showscale: false, hoverinfo: "skip", colorscale: [[0, css("--line-6")], [1, css("--line-6")]] });
    }
    const axis = (title, range) => ({ title: { text: title }, color: css("--soft"), gridcolor: css("--line"), zerolinecolor: css("--line"), backgroundcolor: css("--card"), showbackground: true, ...(range ? { range } : {}) });
    const layout = {
      margin: { l: 30, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)", font: { family: "system-ui, sans-serif", size: 12, color: css("--ink") }, uirevision: "kept",
      scene: { xaxis: axis(`Δp in ${shown("bar")}`), yaxis: axis("U in %"), zaxis: axis(`Q in ${shown("l/min")}`), camera: { eye: { x: -1.83, y: -1.72, z: 0.96 }, center: { x: 0.04, y: 0, z: -0.13 } }, aspectmode: "manual", aspectratio: { x: 1.15, y: 1.15, z: 0.75 } },
    };
    await Plotly.react(plot, traces, layout, { displayModeBar: false, responsive: true, displaylogo: false });
    plotted = Plotly;
    if (!ask.isOpen()) { Plotly.purge(plot); return; }
    const all = found.status.flat(), far = all.filter((s) => s === EXTRAPOLATING).length;
    const reach = found.std.flat().filter(Number.isFinite).sort((a, b) => a - b);
    say(words, `${rows.length ? `${counted(rows.length, "place")} measured. ` : ""}${far ? `${fixed((100 * far) / all.length, 0)} % of the surface is extrapolated (grey): nothing was measured near. ` : "Nothing of the surface is extrapolated. "}Median uncertainty ± ${spreadInUnit(2 * (reach[reach.length >> 1] ?? NaN), "l/min", 2)} ${shown("l/min")}.${colouring === "change" ? (kept ? " Compared with the map kept at this page's request." : before() ? " Compared with the approved map, drawn as a grey sheet." : " Nothing to compare: approve a map, or keep one here.") : ""}`);
  }

  function colours(found) {
    const unit = shown("l/min"), quiet = [[0, css("--note-ground")], [1, css("--line-1")]];
    if (colouring === "std") {
      const values = found.std.map((row) => row.map((s) => 2 * lpm(s))), sorted = values.flat().filter(Number.isFinite).sort((a, b) => a - b);
      return { values, scale: [[0, "#2c7a4b"], [0.5, "#e0b84c"], [1, "#b3261e"]], low: 0, high: sorted[Math.floor(0.95 * sorted.length)] || 1, title: `± 2 σ, ${unit}` };
    }
    if (colouring === "status") {
      return { values: found.status.map((row) => row.map((s) => (s === EXTRAPOLATING ? 1 : 0))), scale: [[0, "#4f86b8"], [0.5, "#4f86b8"], [0.5, css("--far")], [1, css("--far")]], low: 0, high: 1, title: "", ticks: { tickvals: [0.25, 0.75], ticktext: ["measured<br>near", "extra-<br>polated"] } };
    }
    if (colouring === "change") {
      const then = before(), values = then ? found.Q.map((row, i) => row.map((q, j) => lpm(q - then.Q[i][j]))) : found.Q.map((row) => row.map(() => 0));
      const most = Math.max(...values.flat().map(Math.abs).filter(Number.isFinite), 0.5);
      return { values, scale: [[0, "#b3261e"], [0.5, "#e9ecef"], [1, "#1d5fa8"]], low: -most, high: most, title: kept ? `now − kept, ${unit}` : then ? `now − approved, ${unit}` : `nothing to compare, ${unit}` };
    }
    const values = found.Q.map((row) => row.map(lpm));
    return { values, scale: quiet, low: 0, high: Math.max(...values.flat().filter(Number.isFinite), 0.1), title: unit };
  }

  function drawSection() {
    const found = surface();
    if (!found) return;
    const at = (grid) => found.U.map((_, i) => interpolate(found.dp, grid[i], section));
    const flow = at(found.Q), std = at(found.std), points = live.get("Points")?.value ?? [];
    const then = before(), near = (Array.isArray(points) ? points : [points]).filter(([, p]) => Math.abs(p - section) <= NEAR_BAR);
    // measured points lie between the grid's: one axis for both
    const x = [...found.U.map((u, i) => [u, flow[i] + 1.96 * std[i], flow[i] - 1.96 * std[i], flow[i], then ? interpolate(then.dp, then.Q[i], section) : null, null]),
      ...near.map(([u, p, q]) => [u, null, null, null, null, q - slope(found, u, p, section)])].sort((a, b) => a[0] - b[0]);
    guessed = spansOf(found.U, found.U.map((_, i) => interpolate(found.dp, found.status[i].map((s) => Number(s === EXTRAPOLATING)), section) > 0.5));
    const columns = [0, 1, 2, 3, 4, 5].map((k) => x.map((row) => (Number.isFinite(row[k]) ? (k ? lpm(row[k]) : row[k]) : k ? undefined : row[0])));
    chart.chart.setData(columns);
    say(sectionWords, `Δp ${inUnit(section, "bar", 0)} ${shown("bar")} · ${counted(near.length, "point")} within ± ${inUnit(NEAR_BAR, "bar", 0)} ${shown("bar")}${guessed.length ? ` · grey: extrapolated, U ${guessed.map(([from, to]) => `${fixed(from, 0)} to ${fixed(to, 0)} %`).join(", ")}` : ""}`);
  }

  function showStanding() {
    const { old, severity, label, sentence: told } = standingOf(live, valve.name);
    mark(root, "stale", old !== null);
    mark(badge, "severity", severity);
    say(badge, label);
    say(sentence, old ? told : "");
    followRecommended();
  }

  const onMatrix = ({ detail }) => { if (detail === `${selected}.SurfaceStatus` || detail === `${selected}.ApprovedStatus` || detail === "Points") schedule(); };
  live.addEventListener("matrix", onMatrix);
  live.addEventListener("values", showStanding);
  live.addEventListener("standing", showStanding);
  const again = setInterval(showStanding, 1000);
  closers.push(onTheme(() => schedule(true)), inverse.close, approved.close, () => clearInterval(again), () => live.removeEventListener("standing", showStanding),
    () => live.removeEventListener("matrix", onMatrix), () => live.removeEventListener("values", showStanding), () => clearTimeout(redraw), () => plotted?.purge(plot));
  approved.select(selected);
  findPlace();
  showStanding();
  schedule(true);
  return () => closers.forEach((close) => close());
}

const bar = (value) => toShown(value, "bar"), lpm = (value) => spreadShown(value, "l/min");

let loading = null;

/** Plotly is large: it is loaded when a surface is to be drawn. */
function plotly() {
  loading ??= new Promise((resolve, reject) => {
    const script = h("script", { src: "vendor/plotly/plotly-gl3d.min.js" });
    script.onload = () => resolve(window.Plotly);
    script.onerror = reject;
    document.head.append(script);
  });
  return loading;
}

function interpolate(x, y, at) {
  let k = 1;
  while (k < x.length - 1 && x[k] < at) k++;
  const share = (at - x[k - 1]) / (x[k] - x[k - 1]);
  return y[k - 1] + share * (y[k] - y[k - 1]);
}

/** The flow where it is extrapolated, and NaN elsewhere: a sheet that lies on the surface, lest it looks as well known there. */
function extrapolated({ Q, status }) {
  const isFar = (i, j) => status[i]?.[j] === EXTRAPOLATING, beside = [-1, 0, 1], lift = LIFT * Math.max(...Q.flat().filter(Number.isFinite), 0);
  const isTouched = (i, j) => beside.some((a) => beside.some((b) => isFar(i + a, j + b)));
  return Q.map((row, i) => row.map((q, j) => (isTouched(i, j) ? q + lift : NaN)));
}

/** [from, to] of x where it holds, to the middles between its points. */
function spansOf(x, holds) {
  const spans = [];
  x.forEach((at, k) => {
    if (!holds[k]) return;
    const from = k ? (x[k - 1] + at) / 2 : at, to = k < x.length - 1 ? (at + x[k + 1]) / 2 : at;
    if (spans.at(-1)?.[1] === from) spans.at(-1)[1] = to;
    else spans.push([from, to]);
  });
  return spans;
}

/** What the map itself changes between a point's own pressure drop and the section's. */
function slope(found, u, p, section) {
  const row = found.dp.map((_, j) => interpolate(found.U, found.Q.map((r) => r[j]), u));
  return interpolate(found.dp, row, p) - interpolate(found.dp, row, section);
}
