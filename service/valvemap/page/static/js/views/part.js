// A line of a valve with ports, or an axis: what its nodes say, and the voltage for a flow or speed.

import { axisTrendCard } from "../axis_trend.js";
import { lineChart } from "../charts.js";
import { h, lineVariable, mark, onTheme, say } from "../dom.js";
import { CODES, fixed, inUnit, NAN, short, spaced, spreadInUnit } from "../format.js";
import { inverseCard } from "../inverse_card.js";
import { liveCard } from "../live_card.js";
import { slider } from "../slider.js";
import { trackingCard } from "../tracking_card.js";
import { standingOf } from "../trust.js";
import { inUnits, shown, spreadShown, toShown } from "../units.js";

const REFRESH_MS = 1000;
const HALF = 1.96; // of a 95 % interval, in standard deviations
const RATED_BAR = 70; // drop over an edge
const FASTEST = 500; // mm/s of the slider
const UNIT_IN_WORDS = /(?<=, in )\S+(?=\.$)/; // of a variable whose unit has no code, as (l/min)/bar
const BESIDE = /(Std|Lower|Upper)$/; // shown with the value that they are of

export function partView(root, { live, ask, part, user, query, keep }) {
  const isAxis = part.kind === "axis", codes = CODES[part.kind] ?? {}, closers = [];
  const badge = h("span.badge"), sentence = h("span.muted.sentence", { role: "status" }), table = h("tbody");
  const inverse = (isAxis ? speedCard : flowCard)(live, ask, user, part.name);
  const edges = isAxis ? edgesOfAxis(live) : edgesOfLine(live, part);
  const known = h("section.card", {}, h("header", {}, h("h2", {}, isAxis ? "What is known of the axis" : "What is known of the line")),
    h("table.described", {}, h("thead", {}, h("tr", {}, h("th", {}, "What"), h("th.number", {}, "Value"), h("th.number", {}, "± 95 %"))), table));
  const tracking = isAxis ? trackingCard(live, ask) : null;
  const past = isAxis ? axisTrendCard({ live, ask, name: part.name, query, keep }) : null;
  const flow = isAxis ? null : courseOf(live, "Flow of the line", "Q", "l/min"), drive = isAxis ? null : courseOf(live, "Control voltage", "U", "%");
  closers.push(inverse.close, edges.close, () => { for (const one of [tracking, past, flow, drive]) one?.close(); });

  root.append(
    h("div.head", {}, h("h1", {}, part.name), badge, sentence),
    h("div.grid.part-grid", {}, isAxis ? h("div.grid", {}, tracking.element, edges.element, past.element) : h("div.filled", {}, edges.element, known, flow.element), isAxis ? h("div.grid", {}, inverse.element, known) : h("div.filled", {}, inverse.element, drive.element)),
  );

  /** The variables of the part itself and its signals; those of the inverse and of edges have places of their own. */
  function described() {
    const [names, units, sentences] = ["Names", "Units", "Sentences"].map((what) => live.list(`Described.${what}`));
    return names.map((name, k) => ({ name, unit: units[k], sentence: sentences[k] })).filter(({ name }) => {
      const isOwn = !name.includes(".") || name.startsWith("Signals.");
      return isOwn && !BESIDE.test(name) && !(name in codes) && !Array.isArray(live.get(name)?.value) && typeof live.get(name)?.value === "number";
    });
  }

  function showTable() {
    const rows = described();
    while (table.rows.length > rows.length) table.deleteRow(-1);
    rows.forEach(({ name, unit, sentence: about }, k) => {
      const row = table.rows[k] ?? table.appendChild(h("tr", {}, h("td", {}, h("span"), h("small.muted")), h("td.number.value"), h("td.number")));
      const value = live.number(name), std = live.number(`${name}Std`), [title, words] = row.cells[0].children;
      say(title, spaced(name.replace(/^.*\./, "")));
      const said = about.match(UNIT_IN_WORDS)?.[0] ?? "";
      say(words, inUnits(about).replace(UNIT_IN_WORDS, shown));
      say(row.cells[1], unit ? `${inUnit(value, unit, 1)} ${shown(unit)}` : short(toShown(value, said)));
      say(row.cells[2], Number.isFinite(std) ? (unit ? spreadInUnit(HALF * std, unit, 2) : short(spreadShown(HALF * std, said))) : "");
    });
  }

  function showStanding() {
    const { old, severity, label, sentence: about } = standingOf(live, part.name, isAxis ? codes.Status?.[live.number("Status")] : null);
    mark(root, "stale", old !== null);
    mark(badge, "severity", severity);
    say(badge, label);
    const reason = live.get("Reason")?.value || about, leftOut = live.get("LeftOut")?.value?.join?.(", ");
    say(sentence, old ? about : inUnits(`${reason}${leftOut ? ` Left out: ${leftOut}.` : ""}`));
  }

  function update() {
    showStanding();
    showTable();
    edges.update();
  }

  live.addEventListener("standing", update);
  const timer = setInterval(update, REFRESH_MS);
  closers.push(() => clearInterval(timer), () => live.removeEventListener("standing", update));
  update();
  return () => closers.forEach((close) => close());
}

function speedCard(live, ask, user, name) {
  return inverseCard({
    live, ask, user, name, title: "Which U for which speed?", quantity: "SpeedDemand",
    sliders: [slider("Speed (above 0 extends)", "mm/s", -FASTEST, FASTEST, 5, 100)],
    beside: [h("p.words", {}, "At the newest pressures. The play is not in it: add half of it while U rises, subtract half while U falls.")],
    question: ([v]) => live.invertSpeed(name, v),
    demand: ([v]) => ({ demand: name, v }), withdraw: { demand: name, v: null },
    words: ([v]) => `${fixed(v, 0)} mm/s`, verdicts: CODES.axis["Inverse.RequiredUStatus"].map(([severity, , about]) => [severity, about]),
    inForce: () => [live.number("Inverse.SpeedDemand")],
  });
}

function flowCard(live, ask, user, name) {
  const edge = h("p.words"), codes = CODES.line["Inverse.Edge"];
  const showEdge = () => { const [, label, about] = codes[live.number("Inverse.Edge")] ?? [1, NAN, ""]; say(edge, live.oldOf(name) ? "" : `Edge in use: ${label}. ${about}`); };
  live.addEventListener("values", showEdge);
  const made = inverseCard({
    live, ask, user, name, title: "Which U for which flow?", quantity: "FlowDemand",
    sliders: [slider("Flow (below 0 leaves the line)", "l/min", -200, 200, 0.5, 60), slider("Pressure drop", "bar", 1, 300, 1, 100)],
    beside: [edge],
    question: ([flow, dp]) => live.invert(name, flow, dp),
    demand: ([flow, dp]) => ({ demand: name, Q: flow, dp }),
    words: ([flow, dp]) => `${inUnit(flow, "l/min", 1)} ${shown("l/min")} at ${inUnit(dp, "bar", 0)} ${shown("bar")}`,
    inForce: () => [live.number("Inverse.FlowDemand"), live.number("Inverse.PressureDrop")],
  });
  return { ...made, close: () => { live.removeEventListener("values", showEdge); made.close(); } };
}

/** The maps of an axis' edges at the rated drop over each, with 95 % intervals, as far as they are known. */
function edgesOfAxis(live) {
  const body = h("div.chart.fit"), legend = h("div.legend"), words = h("p.words");
  const element = h("section.card.stack.tall", {}, h("header", {}, h("h2", {}, `Flow of the edges at a drop of ${inUnit(RATED_BAR, "bar", 0)} ${shown("bar")}`), h("span.fill"), legend), body, words);
  let chart = null, key = "";

  function update() {
    const names = live.list("Described.Names").filter((name) => name.endsWith(".Flow") && live.has(name)).map((name) => name.split(".")[0]), U = live.get("U")?.value;
    if (!names.length || !U) { say(words, live.old ? `Not known: ${live.old.why}` : "There is no map yet."); return; }
    if (key !== names.join()) {
      chart?.close();
      key = names.join();
      legend.replaceChildren(...names.map((name, k) => h("span", {}, h("i", { style: { "--c": lineVariable(k) } }), name)));
      chart = lineChart(body, null, names.flatMap((name, k) => {
        const colour = `--line-${k + 1}`;
        return [{ label: `${name} upper`, colour, width: 0 }, { label: `${name} lower`, colour, width: 0 }, { label: name, colour, width: 2 }];
      }), { x: "Position of the spool in %", y: `Q in ${shown("l/min")}`, bands: names.map((_, k) => [3 * k + 1, 3 * k + 2, `--line-${k + 1}`]) });
    }
    const columns = names.flatMap((name) => {
      const flow = live.list(`${name}.Flow`), std = live.list(`${name}.FlowStd`), known = live.number(`${name}.KnownTo`);
      const at = (sign) => [...U].map((u, k) => (u <= known && Number.isFinite(flow[k]) ? spreadShown(flow[k] + sign * HALF * (std[k] ?? NaN), "l/min") : null));
      return [at(1), at(-1), [...U].map((u, k) => (u <= known && Number.isFinite(flow[k]) ? spreadShown(flow[k], "l/min") : null))];
    });
    chart.chart.setData([[...U], ...columns]);
    say(words, `Band: 95 % interval. Known up to ${names.map((name) => `${name} ${fixed(live.number(`${name}.KnownTo`), 0)} %`).join(", ")}; beyond, nothing was measured.`);
  }

  const unTheme = onTheme(() => { key = ""; update(); });
  return { element, update, close: () => { unTheme(); chart?.close(); } };
}

/** The newest minute of one of a line's signals. */
function courseOf(live, title, name, unit) {
  const id = `Signals.${name}`;
  return liveCard(live, {
    title, legend: [], unit: `${name} in ${shown(unit)}`, series: [{ label: name, colour: "--line-1" }],
    row: () => [(live.get(id)?.t ?? 0) / 1000, [toShown(live.number(id), unit)]],
  });
}

/** The edges of a line's valve: how each of them stands. */
function edgesOfLine(live, part) {
  const table = h("tbody"), words = h("p.words");
  const element = h("section.card", {}, h("header", {}, h("h2", {}, "Edges of this valve")),
    h("table", {}, h("thead", {}, h("tr", {}, h("th", {}, "Edge"), h("th", {}, "State"), h("th", {}, "Why"), h("th.number", {}, `RMSE, ${shown("l/min")}`))), table), words);
  const edges = live.valves.map(({ name }, number) => ({ name, number })).filter(({ number }) => live.valves[number].family === part.family && !live.valves[number].kind);
  table.append(...edges.map(({ name }) => h("tr", {}, h("td", {}, h("a", { href: live.hrefOf(name) }, name)), h("td", {}, h("span.badge")), h("td"), h("td.number"))));

  function update() {
    edges.forEach(({ name, number }, k) => {
      const [, state, why, rmse] = table.rows[k].cells, row = live.rows.get(number), { severity, label, sentence } = standingOf(live, name);
      mark(state.firstChild, "severity", severity);
      say(state.firstChild, label);
      say(why, sentence);
      say(rmse, spreadInUnit(row?.rmse ?? NaN, "l/min", 2));
    });
    say(words, edges.length ? "U > 0 opens PA and BT, U < 0 opens PB and AT." : "No edge of this valve is learnt.");
  }

  return { element, update, close: () => {} };
}
