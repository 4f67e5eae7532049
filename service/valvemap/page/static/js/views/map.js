// The map of one valve: surface, how sure it is where, a section, and which voltage a flow demands.

import { lineChart } from "../charts.js";
import { css, h, mark, onTheme, say } from "../dom.js";
import { counted, fixed, INVERSE_STATUS } from "../format.js";

const COLOURINGS = [
  ["Q", "Flow", "l/min"], ["std", "Uncertainty", "± 2 σ, l/min"], ["status", "Extrapolated", ""], ["change", "Difference", "l/min"],
];
const EXTRAPOLATING = 6;
const NEAR_BAR = 10; // points so near to a section are drawn on it
const ASK_MS = 150; // between two questions while a slider moves

export function mapView(root, { live, valve, estimator, choose, user }) {
  const closers = [];
  let colouring = "Q", kept = null, plotted = null, section = 100, redraw = 0, asking = false, asked = 0;
  let selected = estimator;

  const which = h("select", { "aria-label": "Estimator", onchange: () => { selected = which.value; kept = null; choose(selected); keepButton(); } },
    valve.estimators.map((name) => h("option", { value: name, selected: name === selected }, name)));
  const colourings = h("span.segments", { role: "group", "aria-label": "Colour by" }, COLOURINGS.map(([key, title]) =>
    h("button", { type: "button", "data-colouring": key, "aria-pressed": String(key === colouring), onclick: () => { colouring = key; schedule(true); } }, title)));
  const keep = h("button.quiet", { type: "button", onclick: () => { kept = surface(); keepButton(); if (kept) colouring = "change"; schedule(true); } }, "Keep to compare");
  const plot = h("div.surface", { role: "img", "aria-label": "Flow over control voltage and pressure drop" });
  const words = h("p.words");
  const sectionChart = h("div.chart"), sectionWords = h("span.muted");
  const sectionSlider = slider("Pressure drop", "bar", 0, 200, 1, section, (value) => { section = value; drawSection(); schedule(); });
  const Q = slider("Flow", "l/min", 0, 200, 0.5, 60, ask), dp = slider("Pressure drop", "bar", 1, 200, 1, 100, ask);
  const answer = h("span.value", { "aria-live": "off" }, "–"), interval = h("span.muted"), verdict = h("span.badge");
  const write = h("button", { type: "button", disabled: true, onclick: demand }, "Write as FlowDemand");
  const written = h("p.words", { role: "status" });
  const standing = h("p.words");

  root.append(
    h("div.head", {}, h("h1", {}, `${valve.name}: map`), h("label", {}, "Estimator ", which), h("span.fill"), h("span.together", {}, h("span.muted", {}, "Colour"), colourings), keep),
    h("div.grid.map-grid", {},
      h("section.card", {}, plot, words),
      h("div.grid", {},
        h("section.card.inverse", {},
          h("header", {}, h("h2", {}, "Which U for which flow?")),
          Q.element, dp.element,
          h("div.answer", {}, h("span.muted", {}, "U ="), answer, interval, verdict),
          h("div.answer", { style: { "margin-top": "8px" } }, write), written, standing),
        h("section.card", {},
          h("header", {}, h("h2", {}, "Section at one pressure drop"), h("span.fill"), sectionWords),
          sectionChart, sectionSlider.element),
      ),
    ),
  );

  const chart = lineChart(sectionChart, 220, [
    { label: "upper", colour: "--line-1", width: 0 }, { label: "lower", colour: "--line-1", width: 0 },
    { label: "Q̂", colour: "--line-1", width: 2 }, { label: "kept", colour: "--line-6", width: 1.5, dash: [5, 4] },
    { label: "measured", colour: "--measured", points: true },
  ], { x: "U in %", y: "Q in l/min", bands: [[1, 2, "--line-1"]], xRange: [0, 100] });
  closers.push(chart.close);

  function keepButton() { say(keep, kept ? "Keep again" : "Keep to compare"); }

  /** The newest surface, all in one. */
  function surface() {
    const of = (name) => live.get(`${selected}.Surface${name}`)?.value;
    const [U, Dp, flow, std, status] = ["U", "Dp", "Q", "Std", "Status"].map(of);
    return U && Dp && flow && std && status ? { U: [...U], dp: [...Dp], Q: flow.map((row) => [...row]), std: std.map((row) => [...row]), status: status.map((row) => [...row]) } : null;
  }

  function schedule(now = false) {
    for (const button of colourings.children) {
      const pressed = String(button.dataset.colouring === colouring);
      if (button.getAttribute("aria-pressed") !== pressed) button.setAttribute("aria-pressed", pressed);
    }
    clearTimeout(redraw);
    redraw = setTimeout(() => { draw(); drawSection(); }, now ? 0 : 60);
  }

  async function draw() {
    const found = surface();
    if (!found) { say(words, "The service is being asked for the map …"); return; }
    const Plotly = await plotly();
    if (!root.contains(plot)) return;
    const colour = colours(found);
    const points = live.get("Points")?.value ?? [];
    const rows = Array.isArray(points) ? points : [points];
    const traces = [
      {
        type: "surface", x: found.dp, y: found.U, z: found.Q, surfacecolor: colour.values, colorscale: colour.scale, cmin: colour.low, cmax: colour.high,
        colorbar: { title: { text: colour.title, side: "top" }, thickness: 12, len: 0.75, tickfont: { color: css("--soft") }, ...colour.ticks }, opacity: 0.96,
        hovertemplate: "U %{y:.1f} %<br>Δp %{x:.0f} bar<br>Q %{z:.1f} l/min<extra></extra>", showscale: true,
      },
      {
        type: "scatter3d", mode: "markers", x: rows.map((r) => r[1]), y: rows.map((r) => r[0]), z: rows.map((r) => r[2]),
        marker: { size: 2.4, color: css("--measured"), opacity: 0.75 }, hoverinfo: "skip", showlegend: false,
      },
      {
        type: "scatter3d", mode: "lines", x: found.U.map(() => section), y: found.U, z: found.Q.map((row) => interpolate(found.dp, row, section)),
        line: { color: css("--ink"), width: 4 }, hoverinfo: "skip", showlegend: false,
      },
    ];
    const axis = (title, range) => ({ title: { text: title }, color: css("--soft"), gridcolor: css("--line"), zerolinecolor: css("--line"), backgroundcolor: css("--card"), showbackground: true, ...(range ? { range } : {}) });
    const layout = {
      margin: { l: 30, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)", font: { family: "system-ui, sans-serif", size: 12, color: css("--ink") }, uirevision: "kept",
      scene: { xaxis: axis("Δp in bar"), yaxis: axis("U in %"), zaxis: axis("Q in l/min"), camera: { eye: { x: -1.83, y: -1.72, z: 0.96 }, center: { x: 0.04, y: 0, z: -0.13 } }, aspectmode: "manual", aspectratio: { x: 1.15, y: 1.15, z: 0.75 } },
    };
    await Plotly.react(plot, traces, layout, { displayModeBar: false, responsive: true, displaylogo: false });
    plotted = Plotly;
    const all = found.status.flat(), far = all.filter((s) => s === EXTRAPOLATING).length;
    const reach = found.std.flat().filter(Number.isFinite).sort((a, b) => a - b);
    say(words, `${rows.length ? `${counted(rows.length, "place")} measured. ` : ""}${far ? `${fixed((100 * far) / all.length, 0)} % of the surface is extrapolated. ` : "Nothing of the surface is extrapolated. "}Median uncertainty ± ${fixed(2 * (reach[reach.length >> 1] ?? NaN), 2)} l/min.${kept ? ` Compared with the map kept at ${kept.at ?? "this page's request"}.` : ""}`);
  }

  function colours(found) {
    const [, , unit] = COLOURINGS.find(([key]) => key === colouring);
    const quiet = [[0, css("--note-ground")], [1, css("--line-1")]];
    if (colouring === "std") {
      const values = found.std.map((row) => row.map((s) => 2 * s)), sorted = values.flat().filter(Number.isFinite).sort((a, b) => a - b);
      return { values, scale: [[0, "#2c7a4b"], [0.5, "#e0b84c"], [1, "#b3261e"]], low: 0, high: sorted[Math.floor(0.95 * sorted.length)] || 1, title: unit };
    }
    if (colouring === "status") {
      return { values: found.status.map((row) => row.map((s) => (s === EXTRAPOLATING ? 1 : 0))), scale: [[0, "#4f86b8"], [0.5, "#4f86b8"], [0.5, "#c7cdd3"], [1, "#c7cdd3"]], low: 0, high: 1, title: "", ticks: { tickvals: [0.25, 0.75], ticktext: ["measured<br>near", "extra-<br>polated"] } };
    }
    if (colouring === "change") {
      const values = kept ? found.Q.map((row, i) => row.map((q, j) => q - kept.Q[i][j])) : found.Q.map((row) => row.map(() => 0));
      const most = Math.max(...values.flat().map(Math.abs).filter(Number.isFinite), 0.5);
      return { values, scale: [[0, "#b3261e"], [0.5, "#e9ecef"], [1, "#1d5fa8"]], low: -most, high: most, title: "now − kept, l/min" };
    }
    return { values: found.Q, scale: [[0, quiet[0][1]], [1, quiet[1][1]]], low: 0, high: Math.max(...found.Q.flat().filter(Number.isFinite), 1), title: unit };
  }

  function drawSection() {
    const found = surface();
    if (!found) return;
    const at = (grid) => found.U.map((_, i) => interpolate(found.dp, grid[i], section));
    const flow = at(found.Q), std = at(found.std), points = live.get("Points")?.value ?? [];
    const near = (Array.isArray(points) ? points : [points]).filter(([, p]) => Math.abs(p - section) <= NEAR_BAR);
    // measured points lie between the grid's: one axis for both
    const x = [...found.U.map((u, i) => [u, flow[i] + 1.96 * std[i], flow[i] - 1.96 * std[i], flow[i], kept ? interpolate(kept.dp, kept.Q[i], section) : null, null]),
      ...near.map(([u, p, q]) => [u, null, null, null, null, q - slope(found, u, p, section)])].sort((a, b) => a[0] - b[0]);
    const columns = [0, 1, 2, 3, 4, 5].map((k) => x.map((row) => (Number.isFinite(row[k]) ? row[k] : k ? undefined : row[0])));
    chart.chart.setData(columns);
    say(sectionWords, `Δp ${fixed(section, 0)} bar · ${counted(near.length, "point")} within ± ${NEAR_BAR} bar`);
  }

  function ask() {
    clearTimeout(asked);
    asked = setTimeout(question, ASK_MS);
  }

  async function question() {
    if (asking) { ask(); return; }
    asking = true;
    const wanted = [Q.value, dp.value];
    const found = await live.invert(valve.name, ...wanted);
    asking = false;
    if (found.error) {
      say(answer, "–"); say(interval, ""); mark(verdict, "severity", 3); say(verdict, found.error);
    } else {
      const [severity, sentence] = INVERSE_STATUS[found.status] ?? [1, ""];
      say(answer, `${fixed(found.U ?? NaN, 2)} %`); // as finely as its interval
      say(interval, found.lower === null ? "" : `95 %: ${fixed(found.lower, 2)} to ${fixed(found.upper, 2)} %`);
      mark(verdict, "severity", severity);
      say(verdict, sentence);
      mark(answer, "u", found.U ?? "");
      mark(answer, "for", `${found.Q}@${found.dp}`);
    }
    if (wanted[0] !== Q.value || wanted[1] !== dp.value) ask();
  }

  async function demand() {
    const [flow, drop] = [Q.value, dp.value];
    const problem = await user.command({ demand: valve.name, Q: flow, dp: drop });
    say(written, problem ?? `Written: FlowDemand ${fixed(flow, 1)} l/min at ${fixed(drop, 0)} bar.`);
  }

  function showUser() {
    write.disabled = !user.name;
    write.title = user.name ? "" : "Log in as an operator of the service first";
    if (!user.name) say(written, "Asking writes nothing. To write FlowDemand, log in as an operator.");
    else if (!written.textContent.startsWith("Written")) say(written, "");
  }

  function showStanding() {
    const U = live.number("Inverse.RequiredU"), flow = live.number("Inverse.FlowDemand"), drop = live.number("Inverse.PressureDrop");
    say(standing, Number.isFinite(flow)
      ? `In force: FlowDemand ${fixed(flow, 1)} l/min at ${fixed(drop, 0)} bar, RequiredU ${fixed(U, 1)} %.`
      : "No FlowDemand is in force.");
  }

  const onMatrix = ({ detail }) => { if (detail === `${selected}.SurfaceStatus` || detail === "Points") schedule(); };
  live.addEventListener("matrix", onMatrix);
  live.addEventListener("values", showStanding);
  user.addEventListener("change", showUser);
  const again = setInterval(ask, 1000); // the map moves on
  closers.push(onTheme(() => schedule(true)), () => clearInterval(again), () => live.removeEventListener("matrix", onMatrix), () => live.removeEventListener("values", showStanding),
    () => user.removeEventListener("change", showUser), () => plotted?.purge(plot));
  showUser();
  showStanding();
  schedule(true);
  ask();
  return () => closers.forEach((close) => close());
}

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

function slider(title, unit, min, max, step, value, onChange) {
  const id = `s${Math.random().toString(36).slice(2)}`;
  const shown = h("output", { for: id }), input = h("input", { id, type: "range", min, max, step, value });
  const decimals = step < 1 ? 1 : 0;
  const say_ = () => { say(shown, `${fixed(Number(input.value), decimals)} ${unit}`); input.setAttribute("aria-valuetext", shown.textContent); };
  input.addEventListener("input", () => { say_(); onChange(Number(input.value)); });
  say_();
  return { element: h("div.slider", {}, h("label", { for: id }, title), input, shown), get value() { return Number(input.value); } };
}

function interpolate(x, y, at) {
  let k = 1;
  while (k < x.length - 1 && x[k] < at) k++;
  const share = (at - x[k - 1]) / (x[k] - x[k - 1]);
  return y[k - 1] + share * (y[k] - y[k - 1]);
}

/** What the map itself changes between a point's own pressure drop and the section's. */
function slope(found, u, p, section) {
  const row = found.dp.map((_, j) => interpolate(found.U, found.Q.map((r) => r[j]), u));
  return interpolate(found.dp, row, p) - interpolate(found.dp, row, section);
}
