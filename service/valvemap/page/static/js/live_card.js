// A chart of the newest minute that fills what is left of a view.

import { History, timeChart } from "./charts.js";
import { h, onTheme, paced } from "./dom.js";

/**
 * `series` as of `timeChart`; `row()` is the newest [t in s, values], NaN where unknown; `past()` (optional) is answered with those of the
 * last minute, undefined where the view has gone; `legend` is [name, colour] of each line that has one.
 */
export function liveCard(live, { title, legend, series, row, past = null, ...options }) {
  const body = h("div.chart.fit"), history = new History(series.length);
  const element = h("section.card.stack.live", {}, h("header", {}, h("h2", {}, title), h("span.fill"),
    h("div.legend", {}, legend.map(([name, colour]) => h("span", {}, h("i", { style: { "--c": `var(${colour})` } }), name)))), body);
  const { chart, close } = timeChart(body, null, series, options);
  const draw = paced(() => chart.setData(history.data));
  let newer = past ? [] : null; // what comes while the past is read

  function take() {
    const [t, values] = row();
    if (t > 0) { if (newer) newer.push([t, values]); else history.add(t, values); }
    draw();
  }

  async function fill() {
    const found = await past();
    if (!found) return;
    const first = newer[0]?.[0] ?? Infinity;
    for (const [t, values] of [...found.filter(([t]) => t < first), ...newer]) history.add(t, values);
    newer = null;
    draw();
  }

  live.addEventListener("values", take);
  const unTheme = onTheme(draw);
  take();
  if (past) fill();
  return { element, close: () => { live.removeEventListener("values", take); unTheme(); close(); } };
}
