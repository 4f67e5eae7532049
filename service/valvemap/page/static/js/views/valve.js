// One valve, live: signals, measured and predicted flow, residuals, parameters, estimators side by side.

import { History, SECOND_AXIS, timeChart } from "../charts.js";
import { css, h, mark, onTheme, paced, pen, say } from "../dom.js";
import { ADAPTATION, clock, count, fixed, inUnit, REASONS, short, SIGNALS, span, spreadInUnit, STATUS } from "../format.js";
import { standingOf } from "../trust.js";
import { inUnits, shown as shownUnit, spreadShown, toShown } from "../units.js";
import { estimatorTable } from "./estimator_table.js";
import { drawnResiduals } from "./residuals.js";

const RESIDUALS = 600; // of the newest minute
const MOST_PARAMETERS = 100; // a network has hundreds, of which none says anything alone
const MINUTE_MS = 60000, STEP_MS = 100; // of history, with which the charts begin
const REDRAW_MS = 250; // of what is counted rather than seen

export function valveView(root, { live, ask, valve, estimator, isChosen, choose }) {
  const estimators = valve.estimators;
  const closers = [];
  const flows = new History(4), residuals = new History(3), drives = new History(2);
  const bySelected = [];
  let selected = estimators.includes(estimator) ? estimator : valve.primary;
  let drawnAt = 0, waiting = null;

  const signals = Object.fromEntries(Object.keys(SIGNALS).map((name) => [name, signalTile(name)]));
  const badge = h("span.badge"), sentence = h("span.muted.sentence");
  const best = h("strong"), bestReason = h("p"), bestLinks = h("p.links", {}, h("a.button", { href: `#/map/${encodeURIComponent(valve.name)}` }, "Map"), h("a.button", { href: `#/trend/${encodeURIComponent(valve.name)}` }, "Trend"), h("a.button", { href: "#/alarms" }, "Alarms"));
  let areAllShown = localStorage.getItem("diagnostics") === "open";
  const more = h("button.quiet.more", { type: "button", onclick: () => {
    areAllShown = !areAllShown;
    localStorage.setItem("diagnostics", areAllShown ? "open" : "");
    showOthers();
  } });
  const table = estimatorTable(estimators, live.quantities, (name) => select(name));
  const parameters = h("tbody"), parametersTitle = h("h2");
  const residualCards = drawnResiduals();
  const facts = h("dl.facts");
  const flowChart = h("div.chart"), residualChart = h("div.chart"), driveChart = h("div.chart");
  for (const body of [flowChart, residualChart, driveChart]) body.classList.add("fit");
  const driveCard = card("Control voltage and pressure drop", driveChart, legend(["U", "--line-1"], ["Δp", "--line-2"]));

  root.append(
    h("div.head", {}, h("h1", {}, valve.name), badge, sentence),
    h("section.signals", { "aria-label": "Signals" }, Object.values(signals).map((tile) => tile.element)),
    h("div.grid.valve-grid", {},
      h("div.grid", {},
        card("Flow, measured and predicted", flowChart, flowLegend()),
        card("Residual Q − Q̂", residualChart),
        driveCard,
      ),
      h("div.grid", {},
        h("section.card.best", {}, h("header", {}, h("h2", {}, "Recommended map"), best), bestReason, bestLinks,
          table.element, more),
        residualCards.element,
        h("section.card.parameters", {}, h("header", {}, parametersTitle),
          h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Parameters" },
            h("table", {}, h("thead", {}, h("tr", {}, h("th", {}, "Name"), h("th.number", {}, "Value"), h("th.number", {}, "± 2 σ"), h("th", {}, "relative"))), parameters))),
        h("section.card", {}, h("header", {}, h("h2", {}, "In words")), facts),
      ),
    ),
  );

  const flow = timeChart(flowChart, null, [
    { label: "upper", colour: "--line-1", width: 0 }, { label: "lower", colour: "--line-1", width: 0 },
    { label: "predicted", colour: "--line-1", width: 1.5 }, { label: "measured", colour: "--measured", dots: true },
  ], { unit: `Q in ${shownUnit("l/min")}`, bands: [[1, 2, "--line-1"]], right: SECOND_AXIS });
  const residual = timeChart(residualChart, null, [
    { label: "upper", colour: "--line-6", width: 0 }, { label: "lower", colour: "--line-6", width: 0 },
    { label: "residual", colour: "--line-1", width: 1.25 },
  ], { unit: shownUnit("l/min"), bands: [[1, 2, "--line-6"]], right: SECOND_AXIS });
  const drive = timeChart(driveChart, null, [
    { label: "U", colour: "--line-1" }, { label: "Δp", colour: "--line-2", scale: "second" },
  ], { unit: "U in %", unit2: `Δp in ${shownUnit("bar")}` });
  closers.push(flow.close, residual.close, drive.close);

  function select(name) {
    selected = name;
    choose(name);
    flows.clear();
    residuals.clear();
    bySelected.length = 0;
    drives.clear();
    drawnAt = 0;
    fill();
    take();
  }

  /** Begin with the last minute of the service's history: a change of view loses nothing. */
  async function fill() {
    const now = Date.now(), of = selected;
    waiting = [];
    const found = await ask("minute", live.trend(valve.name, ["PredictedFlow", "Residual", "NoiseStd"].map((name) => `${of}.${name}`).concat("Signals.U", "Signals.dp"), now - MINUTE_MS, now, STEP_MS));
    if (!found) return;
    const newer = waiting;
    waiting = null;
    if (!found.error) {
      const [predicted, missed, noise, U, dp] = found.courses.map(([mean]) => mean), first = newer[0]?.[0] ?? Infinity;
      predicted.forEach((value, k) => {
        const t = (found.start + (k + 0.5) * found.step) / 1000;
        if (Number.isFinite(value) && t < first) add(t, value, missed[k], noise[k], U[k], dp[k]);
      });
    }
    newer.forEach((row) => add(...row));
    soon();
  }

  function add(t, predicted, missed, noise, U, dp) {
    const reach = 1.96 * noise, shown = (value) => toShown(value, "l/min");
    if (Number.isFinite(missed)) bySelected.push(missed);
    if (bySelected.length > RESIDUALS) bySelected.shift();
    flows.add(t, [predicted + reach, predicted - reach, predicted, predicted + missed].map(shown));
    residuals.add(t, [2 * noise, -2 * noise, missed].map((value) => spreadShown(value, "l/min")));
    drives.add(t, [U, toShown(dp, "bar")]);
  }

  /** Keep what is new; what is seen of it follows at the machine's pace. */
  function take() {
    const of = (name) => `${selected}.${name}`;
    const entry = live.get(of("PredictedFlow"));
    if (entry?.t) {
      const t = entry.t / 1000;
      const row = [t, entry.value, live.number(of("Residual")), live.number(of("NoiseStd")), live.number("Signals.U"), live.number("Signals.dp")];
      if (waiting) { if (t > (waiting.at(-1)?.[0] ?? -Infinity)) waiting.push(row); } else if (t > residuals.last) add(...row);
    }
    soon();
  }

  const soon = paced(() => {
    for (const name in signals) signals[name].show(live);
    driveCard.hidden = !live.has("Signals.U"); // an older service does not publish its signals
    flow.chart.setData(flows.data);
    residual.chart.setData(residuals.data);
    drive.chart.setData(drives.data);
    table.show(live, selected, live.oldOf(valve.name));
    followRecommended();
    if (performance.now() - drawnAt < REDRAW_MS) return;
    drawnAt = performance.now();
    standing();
    residualCards.draw(bySelected, live.number(`${selected}.NoiseStd`));
    showParameters();
    showFacts();
  });

  /** The recommended estimator is shown, unless another one was chosen. */
  function followRecommended() {
    const recommended = live.get("Recommended")?.value;
    if (!isChosen && recommended && recommended !== selected && estimators.includes(recommended)) {
      select(recommended);
      isChosen = false;
    }
  }

  /** The recommended estimator stands alone until the others are asked for. */
  function showOthers() {
    const best = live.get("Recommended")?.value, isAlone = estimators.includes(best) && estimators.length > 1;
    more.hidden = !isAlone;
    more.setAttribute("aria-expanded", String(areAllShown));
    say(more, areAllShown ? "Hide the other estimators" : `Diagnostics: ${estimators.length - 1} other estimators`);
    estimators.forEach((name, k) => { table.rows[k].hidden = isAlone && !areAllShown && name !== best && name !== selected; });
  }

  function standing() {
    showOthers();
    const row = live.rowOf(valve.name), { old, severity, label, sentence: words } = standingOf(live, valve.name);
    const recommended = live.get("Recommended")?.value, reason = live.get("RecommendedReason")?.value;
    say(best, old ? "not known now" : recommended || "none yet");
    say(bestReason, inUnits(reason || (recommended ? "" : "No estimator stands out yet: places must be visited again.")));
    mark(root, "stale", old !== null);
    mark(badge, "severity", severity);
    say(badge, label);
    if (old || !row) { say(sentence, words); return; }
    const status = live.number(`${selected}.Status`);
    const since = row.severity ? ` since ${clock(row.since)}` : "";
    const next = row.severity > 1 ? " See Alarms for what to do." : "";
    say(sentence, `${row.severity ? `${REASONS[row.reason][1].replace(/\.$/, "")}${since}.${next} ` : ""}${selected}: ${STATUS[status]?.[1].split(". ")[0].replace(/\.?$/, ".") ?? "nothing known yet"} ${count(live.number(`${selected}.SampleCount`))} samples.`);
  }

  function showParameters() {
    const names = live.list(`${selected}.ParameterNames`), std = live.list(`${selected}.ParameterStd`);
    say(parametersTitle, `Parameters of ${selected}${names.length > MOST_PARAMETERS ? `, the first ${MOST_PARAMETERS} of ${names.length}` : ""}`);
    const shown = names.slice(0, MOST_PARAMETERS);
    while (parameters.rows.length > shown.length) parameters.deleteRow(-1);
    shown.forEach((name, k) => {
      const row = parameters.rows[k] ?? parameters.appendChild(h("tr", {}, h("td"), h("td.number.value"), h("td.number"), h("td", {}, h("canvas.std", { "aria-hidden": "true" }))));
      const value = live.number(`${selected}.ParameterVector.${name}`), reach = 2 * (std[k] ?? NaN);
      say(row.cells[0], name);
      say(row.cells[1], short(value));
      say(row.cells[2], short(reach));
      drawStd(row.cells[3].firstChild, value, reach);
    });
  }

  function showFacts() {
    const of = (name) => live.number(`${selected}.${name}`), lines = [];
    const [status, about] = STATUS[of("Status")] ?? ["–", ""], old = live.oldOf(valve.name);
    lines.push(["Status", old ? `not known: ${old.why}` : `${status}: ${about}`]);
    const age = live.number("Diagnostics.SampleAge");
    const row = live.rowOf(valve.name);
    lines.push(["Newest sample", old ? `not known now${old.since ? `; the last before ${clock(old.since)}` : ""}` : Number.isFinite(age) ? `${span(age)} old` : row ? `seen ${span(row.silent)} ago` : "–"]);
    const lagU = live.number("Diagnostics.LagU"), lagQ = live.number("Diagnostics.LagQ");
    if (Number.isFinite(lagU) || Number.isFinite(lagQ)) {
      lines.push(["Lag", `${Number.isFinite(lagU) ? `U ${fixed(1000 * lagU, 0)} ms` : "U unknown"}, ${Number.isFinite(lagQ) ? `Q ${fixed(1000 * lagQ, 0)} ms` : "Q unknown"}`]);
    }
    const adaptation = of("Adaptation");
    if (ADAPTATION[adaptation]) lines.push(["Adaptation", ADAPTATION[adaptation].join(": ")]);
    const structure = live.get(`${selected}.Structure`)?.value;
    if (structure) lines.push(["Structure", inUnits(structure)]);
    const share = of("CoverageShare");
    if (Number.isFinite(share)) lines.push(["Coverage", `${fixed(100 * share, 0)} % of the range measured recently`]);
    const changes = of("ChangeCount");
    if (Number.isFinite(changes)) {
      const when = of("ChangeTime");
      lines.push(["Abrupt changes", changes ? `${changes}, the last at ${clock(when)}: ${spreadInUnit(of("ChangeSize"), "l/min", 1)} ${shownUnit("l/min")}` : "none"]);
    }
    const causes = live.list("Diagnostics.Findings"), chances = live.list("Diagnostics.FindingProbabilities");
    causes.forEach((sentence, k) => lines.push([k ? "" : "Findings", `${fixed(100 * chances[k], 0)} %: ${inUnits(sentence)}`]));
    const dynamics = live.get("Dynamics.Reason")?.value;
    if (dynamics) lines.push(["Dynamics", inUnits(dynamics)]);
    const waiting = live.get("Diagnostics.Waiting")?.value?.join?.("; ");
    if (waiting) lines.push(["Waiting for", inUnits(String(waiting))]);
    const action = live.get("Diagnostics.LastAction")?.value;
    if (action) lines.push(["Last action", inUnits(action)]);
    lines.forEach(([name, text], k) => {
      const dt = facts.children[2 * k] ?? facts.appendChild(h("dt")), dd = facts.children[2 * k + 1] ?? facts.appendChild(h("dd"));
      say(dt, name);
      say(dd, text);
    });
    while (facts.children.length > 2 * lines.length) facts.lastChild.remove();
  }

  live.addEventListener("values", take);
  closers.push(() => live.removeEventListener("values", take), onTheme(() => { drawnAt = 0; soon(); }));
  live.addEventListener("standing", standing);
  closers.push(() => live.removeEventListener("standing", standing));
  const slow = setInterval(() => {
    const old = live.oldOf(valve.name);
    standing();
    table.show(live, selected, old);
    if (old) showFacts(); // nothing else would write that they are not of now
  }, 1000);
  closers.push(() => clearInterval(slow));
  fill();
  take();
  return () => closers.forEach((close) => close());
}

function signalTile(name) {
  const unit = SIGNALS[name][1], value = h("span.digits"), element = h("div.signal", { "data-signal": name },
    h("span.name", {}, SIGNALS[name][0]), h("span.value", {}, value, h("span.unit", {}, shownUnit(unit))));
  return {
    element,
    show(live) {
      let shown = live.number(`Signals.${name}`);
      if (name === "Q" && Number.isNaN(shown)) { // Q is known by its prediction, too
        const first = live.names().find((known) => known.endsWith(".PredictedFlow"))?.split(".")[0];
        shown = live.number(`${first}.PredictedFlow`) + live.number(`${first}.Residual`);
      }
      element.hidden = name !== "Q" && !live.has(`Signals.${name}`);
      say(value, inUnit(shown, unit, 1));
      mark(element, "quality", live.quality(`Signals.${name}`));
    },
  };
}

function card(title, body, extra = null) {
  return h("section.card", {}, h("header", {}, h("h2", {}, title), h("span.fill"), extra), body);
}

function legend(...lines) {
  return h("div.legend", {}, lines.map(([name, colour]) => h("span", {}, h("i", { style: { "--c": `var(${colour})` } }), name)));
}

function flowLegend() {
  return h("div.legend", {},
    h("span", {}, h("i.dot", { style: { "--c": "var(--measured)" } }), "measured"),
    h("span", {}, h("i", { style: { "--c": "var(--line-1)" } }), "predicted"),
    h("span", {}, h("i", { style: { "--c": "color-mix(in srgb, var(--line-1) 25%, transparent)", height: "9px" } }), "95 % of measurements"));
}

/** Where a parameter lies, and how far it may be off, relative to its size. */
function drawStd(canvas, value, reach) {
  const { context, width, height } = pen(canvas);
  const relative = Math.abs(reach / value);
  if (!Number.isFinite(relative)) return;
  const half = Math.min(relative, 1) * (width / 2 - 3), middle = width / 2;
  context.strokeStyle = css("--line"); context.lineWidth = 1;
  context.beginPath(); context.moveTo(0, height / 2); context.lineTo(width, height / 2); context.stroke();
  context.fillStyle = relative > 0.5 ? css("--warning") : css("--line-1");
  context.fillRect(middle - Math.max(half, 1), height / 2 - 3, 2 * Math.max(half, 1), 6);
}
