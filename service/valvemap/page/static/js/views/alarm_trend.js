// What the signals did around an alarm, from the service's history; its time is shaded.

import { shadeSpans, timeChart } from "../charts.js";
import { css, h, onTheme } from "../dom.js";
import { stepOf } from "../spans.js";
import { tabled } from "../trend_rows.js";
import { shown } from "../units.js";

const PREDICTED = "PredictedFlow"; // of the valve's first estimator
const LANES = [ // title, unit, series [name, caption, unit, colour]
  ["Flow", "l/min", [["Signals.Q", "Q", "l/min", "--measured"], [PREDICTED, "Q̂", "l/min", "--line-1"]]],
  ["Pressures", "bar", [["Signals.p1", "p₁", "bar", "--line-1"], ["Signals.p2", "p₂", "bar", "--line-2"], ["Signals.dp", "Δp", "bar", "--line-3"]]],
  ["Control voltage", "%", [["Signals.U", "U", "%", "--line-1"]]],
];
const SERIES = LANES.flatMap(([, , of]) => of);

/** `show(valve, alarm, [from, to], ask)` in ms; without a valve of its own, an alarm has none. */
export function alarmTrend(live) {
  let range = [0, 1], span = [0, 0], of = "";
  const shade = (chart) => shadeSpans(chart, [span.map((ms) => ms / 1000)], `${css("--alarm")}22`);
  const bodies = LANES.map(() => h("div.chart.fit"));
  const element = h("div.alarm-trend", { hidden: true }, LANES.map(([title, , series], k) => h("div.lane", {},
    h("header", {}, h("h2", {}, title), h("span.fill"), h("div.legend", {}, series.map(([, caption, , colour]) => h("span", {}, h("i", { style: { "--c": `var(${colour})` } }), caption)))), bodies[k])));
  const drawn = LANES.map(([, unit, series], k) => timeChart(bodies[k], null, series.map(([, label, , colour]) => ({ label, colour })),
    { unit: shown(unit), span: () => range.map((ms) => ms / 1000), hooks: { drawClear: [shade] } }));
  const stop = onTheme(() => drawn.forEach(({ chart }) => chart.redraw()));

  async function show(name, { t, until, active }, [from, to], ask) {
    const valve = live.valves.find((one) => one.name === name), key = JSON.stringify([name, t, until, active]);
    if (!valve) { element.hidden = true; of = ""; return; }
    if (of === key) return;
    of = key;
    const names = SERIES.map(([series]) => (series === PREDICTED ? `${valve.primary}.${series}` : series));
    const found = await ask("around", live.trend(name, names, from, to, stepOf(to - from)));
    if (!found) return;
    const rows = found.error ? null : tabled(SERIES, found);
    if (found.error) of = ""; // asked again
    element.hidden = !rows?.t.length;
    if (element.hidden) return;
    [range, span] = [[from, to], [t, until ?? (active ? to : t)]];
    let first = 0;
    LANES.forEach(([, , series], k) => {
      drawn[k].chart.setData([rows.t, ...rows.of.slice(first, first + series.length).map(([mean]) => mean)]);
      first += series.length;
    });
  }

  return { element, show, close: () => { stop(); drawn.forEach(({ close }) => close()); } };
}
