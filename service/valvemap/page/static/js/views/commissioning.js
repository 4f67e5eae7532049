// What a new valve still lacks: rates, losses, what is not measured yet, the next test point.

import { css, h, mark, onTheme, pen, say } from "../dom.js";
import { count, fixed, inUnit, span, spreadInUnit } from "../format.js";
import { told } from "../trust.js";
import { inUnits, shown } from "../units.js";
import { guidedRun } from "./guided_run.js";
import { sheetCard } from "./sheet_card.js";

const REFRESH_MS = 1000;
const RATE_S = 10; // over which rates are taken: what comes in bursts is counted evenly
const COUNTERS = {
  Aligned: "samples with all signals aligned", Late: "signals too late", Missing: "samples dropped: a signal was missing",
  Duplicates: "signals received twice", ClockSteps: "jumps of the source's clock", Gaps: "samples lost, by Sequence", LostByTime: "samples lost, by time",
  BadStatus: "rejected: OPC UA status", NotFinite: "rejected: no finite number", OutOfRange: "rejected: outside the sensor's range",
  Frozen: "rejected: a signal was frozen", TooFast: "rejected: a signal changed too fast", Spike: "rejected: spikes", BeyondRange: "not learnt from: U beyond range", TooFastForLag: "not learnt from: too fast for the lags",
};
const NOT_FOUND = "not found yet"; // what Diagnostics.Timing says first
const FRESH_S = 600; // an older region wants another visit

export function commissioningView(root, { live, ask, valve, estimator, choose }) {
  let selected = estimator, seen = [];
  const which = h("select", { "aria-label": "Estimator", onchange: () => { selected = which.value; choose(selected); } },
    valve.estimators.map((name) => h("option", { value: name, selected: name === selected }, name)));
  const run = guidedRun({ live, ask, valve }), sheet = sheetCard({ live, valve });
  const checks = h("ul.checks"), heat = h("canvas.heat", { role: "img", "aria-label": "Uncertainty over control voltage and pressure drop" });
  const heatWords = h("p.words"), next = h("p"), counters = h("tbody"), rate = h("span.value"), rateWords = h("span.muted"), coming = h("ul.words.coming");

  root.append(
    h("div.head", {}, h("h1", {}, `${valve.name}: commissioning`), h("label", {}, "Estimator ", which)),
    h("div.grid.valve-grid", {},
      h("div.grid", {},
        h("section.card", {}, h("header", {}, h("h2", {}, "Where the map is known"), h("span.fill"), h("div.legend", {},
          h("span", {}, h("i", { style: { "--c": "#2c7a4b", height: "9px" } }), "sure"), h("span", {}, h("i", { style: { "--c": "#e0b84c", height: "9px" } }), "less"),
          h("span", {}, h("i", { style: { "--c": "#b3261e", height: "9px" } }), "unsure"), h("span", {}, h("i.dot", { style: { "--c": "var(--ink)" } }), "next test point"))),
          heat, heatWords),
        h("section.card", {}, h("header", {}, h("h2", {}, "The next test point")), next),
        sheet.element,
      ),
      h("div.grid", {},
        run.element,
        h("section.card", {}, h("header", {}, h("h2", {}, "What is missing for a map")), checks),
        h("section.card", {}, h("header", {}, h("h2", {}, "Samples, lost and rejected"), h("span.fill"), rate, rateWords),
          h("table", {}, h("thead", {}, h("tr", {}, h("th", {}, "What"), h("th.number", {}, "Count"), h("th.number", {}, "per s"))), counters),
          h("p.words", {}, "How the signals arrive, as found at the start:"), coming),
      ),
    ),
  );

  function update() {
    const of = (name) => live.number(`${selected}.${name}`);
    const now = performance.now() / 1000, names = Object.keys(COUNTERS).filter((name) => live.has(`Diagnostics.${name}`));
    const counts = Object.fromEntries([...names.map((name) => [name, live.number(`Diagnostics.${name}`)]), ["SampleCount", of("SampleCount")]]);
    seen = seen.filter((one) => one.selected === selected && now - one.now < RATE_S);
    const per = (name) => (seen.length ? (counts[name] - seen[0].counts[name]) / (now - seen[0].now) : NaN);
    while (counters.rows.length < names.length) counters.append(h("tr", {}, h("td"), h("td.number"), h("td.number")));
    names.forEach((name, k) => {
      const { cells } = counters.rows[k];
      say(cells[0], COUNTERS[name]);
      say(cells[1], count(counts[name]));
      say(cells[2], fixed(per(name), 1));
    });
    const perSecond = per("Aligned");
    say(rate, Number.isFinite(perSecond) && !live.oldOf(valve.name) ? fixed(perSecond, 1) : "–");
    say(rateWords, " samples/s");
    showChecks(of, counts, per);
    showComing();
    drawHeat(of);
    run.update();
    sheet.update();
    seen.push({ now, counts, selected });
  }

  function showChecks(of, counts, per) {
    const lost = ["Missing", "Late", "Gaps"].reduce((sum, name) => sum + (counts[name] || 0), 0), share = of("CoverageShare");
    const rejected = ["BadStatus", "NotFinite", "OutOfRange", "Frozen", "TooFast", "Spike", "BeyondRange", "TooFastForLag"].reduce((sum, name) => sum + (counts[name] || 0), 0);
    const samples = of("SampleCount"), condition = of("Conditioning"), rejecting = rejected / Math.max(counts.Aligned, 1);
    const waiting = live.get("Diagnostics.Waiting")?.value?.join?.("; ");
    const arriving = Number.isFinite(per("Aligned")) ? per("Aligned") > 0 : counts.Aligned > 0; // no rate yet at the first look
    const old = live.oldOf(valve.name);
    mark(root, "stale", old !== null);
    const missing = waiting || (timing()[0] === NOT_FOUND ? "how the signals come is being found out; that takes scans of all of them." : "");
    const lines = old ? [[false, `${told(old)} Nothing else is known now.`], ...(missing && !live.old && !old.isStart ? [[false, inUnits(`No samples: ${missing}`)]] : [])] : [
      [arriving, arriving ? "Signals arrive and are aligned." : inUnits(`No samples: ${missing || "a signal is missing."}`)],
      [lost === 0, lost === 0 ? "Nothing was lost on the way." : `${count(lost)} signals or samples were lost on the way.`],
      [rejecting < 0.01, rejected === 0 ? "No sample was rejected." : `${fixed(100 * rejecting, 1)} % of the samples were rejected.`],
      [samples >= 1000, samples >= 1000 ? `${count(samples)} samples learnt from.` : `${count(samples)} samples so far; a map needs 1 000.`],
      [share >= 0.6, Number.isFinite(share) ? `${fixed(100 * share, 0)} % of the range was measured recently; a map needs 60 %.` : "How much of the range was measured is not known yet."],
      [of("Status") === 0, of("Status") === 0 ? "All parameters are determined." : "Not all parameters are determined, or the signals hold still."],
    ];
    if (!old && Number.isFinite(condition)) lines.push([condition < 1e4, condition < 1e4 ? "U and Δp vary enough, and apart from each other." : "U and Δp vary too little, or only together: vary one while the other rests."]);
    while (checks.children.length < lines.length) checks.append(h("li", {}, h("span")));
    while (checks.children.length > lines.length) checks.lastChild.remove();
    lines.forEach(([done, text], k) => {
      mark(checks.children[k], "done", done);
      say(checks.children[k].firstChild, text);
    });
  }

  function timing() {
    return live.list("Diagnostics.Timing");
  }

  function showComing() {
    const said = timing().length ? timing() : ["–"];
    while (coming.children.length < said.length) coming.append(h("li"));
    while (coming.children.length > said.length) coming.lastChild.remove();
    said.forEach((text, k) => say(coming.children[k], inUnits(text)));
  }

  function drawHeat(of) {
    const std = live.get(`${selected}.Coverage`)?.value, age = live.get(`${selected}.CoverageAge`)?.value;
    const U = live.get("Diagnostics.CoverageU")?.value, dp = live.get("Diagnostics.CoverageDp")?.value;
    const [u, p] = [of("SuggestedU"), of("SuggestedDp")];
    say(next, Number.isFinite(u) ? `U ${fixed(u, 0)} % at Δp ${inUnit(p, "bar", 0)} ${shown("bar")} would make the map surer than any other point.` : "No point stands out yet.");
    heat.hidden = !Array.isArray(std) || !U || !dp;
    if (heat.hidden) { say(heatWords, "The service has not surveyed this map yet."); return; }
    const { context, width, height } = pen(heat), left = 42, bottom = 34;
    const w = (width - left - 8) / dp.length, hgt = (height - bottom - 4) / U.length;
    const known = std.flatMap((row) => [...row]).filter(Number.isFinite).sort((a, b) => a - b);
    const noise = of("NoiseStd"), most = noise > 0 ? noise : known[Math.floor(0.9 * known.length)] || 1;
    std.forEach((row, i) => row.forEach((s, j) => {
      const x = left + j * w, y = height - bottom - (i + 1) * hgt;
      const seen = Array.isArray(age) ? age[i]?.[j] : NaN;
      context.globalAlpha = Number.isFinite(seen) ? (seen < FRESH_S ? 1 : 0.6) : 0.28;
      context.fillStyle = Number.isFinite(s) ? mix(s / most) : css("--line");
      context.fillRect(x + 1, y + 1, w - 2, hgt - 2);
    }));
    context.globalAlpha = 1;
    context.fillStyle = css("--soft");
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    dp.forEach((value, j) => { if (j % 2 === 0) context.fillText(inUnit(value, "bar", 0), left + (j + 0.5) * w, height - bottom + 14); });
    context.fillText(`Δp in ${shown("bar")}`, left + (width - left) / 2, height - 3);
    context.textAlign = "right";
    U.forEach((value, i) => { if (i % 2 === 0) context.fillText(fixed(value, 0), left - 6, height - bottom - (i + 0.5) * hgt + 4); });
    context.save();
    context.translate(11, (height - bottom) / 2);
    context.rotate(-Math.PI / 2);
    context.textAlign = "center";
    context.fillText("U in %", 0, 0);
    context.restore();
    if (Number.isFinite(u)) {
      const x = left + (cell(dp, p) + 0.5) * w, y = Math.max(height - bottom - (cell(U, u) + 0.5) * hgt, 8);
      context.beginPath();
      context.arc(x, y, 6, 0, 2 * Math.PI);
      context.fillStyle = css("--ink");
      context.fill();
      context.lineWidth = 2;
      context.strokeStyle = css("--card");
      context.stroke();
    }
    const never = Array.isArray(age) ? age.flatMap((row) => [...row]).filter((seconds) => !Number.isFinite(seconds)).length : 0;
    say(heatWords, `${never} of ${U.length * dp.length} regions were never measured (palest); the pale ones not for ${span(FRESH_S)}. Red: the map is as unsure as one measurement, ± ${spreadInUnit(2 * most, "l/min", 2)} ${shown("l/min")}.`);
  }

  const timer = setInterval(update, REFRESH_MS);
  const forget = onTheme(update);
  live.addEventListener("standing", update);
  update();
  return () => { clearInterval(timer); live.removeEventListener("standing", update); forget(); run.end(); };
}

/** Where a value lies between the middles of cells: 0 is the middle of the first. */
function cell(middles, value) {
  let k = 1;
  while (k < middles.length - 1 && middles[k] < value) k++;
  const at = k - 1 + (value - middles[k - 1]) / (middles[k] - middles[k - 1]);
  return Math.min(Math.max(at, -0.5), middles.length - 0.5);
}

/** green → yellow → red */
function mix(share) {
  const stops = [[44, 122, 75], [224, 184, 76], [179, 38, 30]], x = Math.min(Math.max(share, 0), 1) * 2, k = Math.min(Math.floor(x), 1);
  return `rgb(${stops[k].map((from, c) => Math.round(from + (x - k) * (stops[k + 1][c] - from))).join(" ")})`;
}
