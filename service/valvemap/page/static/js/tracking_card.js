// Position and tracking error of all axes with a set position, side by side.

import { lineChart } from "./charts.js";
import { h, lineVariable, onTheme, say } from "./dom.js";
import { fixed } from "./format.js";

const REFRESH_MS = 1000;
const SPAN_S = 20;
const HEIGHT = 150;

export function trackingCard(live, ask) {
  const above = h("div.chart"), below = h("div.chart"), legend = h("div.legend"), words = h("p.words");
  const element = h("section.card.stack", { hidden: true }, h("header", {}, h("h2", {}, "How the axes follow their set positions"), h("span.fill"), legend), above, below, words);
  let charts = [], key = "", isAsking = false;

  function draw(axes) {
    charts.forEach((chart) => chart.close());
    legend.replaceChildren(
      ...axes.map(({ name }, k) => h("span", {}, h("i", { style: { "--c": lineVariable(k) } }), `${name} `, h("b"))),
      h("span", {}, "dashed: set position"),
    );
    const lines = axes.map(({ name }, k) => ({ label: name, colour: `--line-${k + 1}`, width: 1.5 }));
    const sets = axes.map(({ name }) => ({ label: `${name} set`, colour: "--soft", width: 1, dash: [4, 4] }));
    const options = { xRange: () => [-SPAN_S, 0] };
    charts = [
      lineChart(above, HEIGHT, [...lines, ...sets], { x: "", y: "Position in mm", ...options }),
      lineChart(below, HEIGHT, lines, { x: "Time in s", y: "Error in mm", ...options }),
    ];
  }

  /** One time axis of all: the points of different axes do not meet, the lines go on over the gaps. */
  function show(axes) {
    element.hidden = !axes.length;
    if (!axes.length) return;
    const now = axes.map(({ name }) => name).join();
    if (key !== now) { key = now; draw(axes); }
    const newest = Math.max(...axes.map(({ t }) => t.at(-1) ?? 0));
    const times = [...new Set(axes.flatMap(({ t }) => t))].sort((one, other) => one - other);
    const at = new Map(times.map((t, k) => [t, k])), shown = times.map((t) => t - newest);
    const column = ({ t }, values) => {
      const placed = Array(times.length).fill(null);
      t.forEach((moment, k) => { placed[at.get(moment)] = values[k]; });
      return placed;
    };
    const xs = axes.map((axis) => column(axis, axis.x)), sets = axes.map((axis) => column(axis, axis.set));
    charts[0].chart.setData([shown, ...xs, ...sets]);
    charts[1].chart.setData([shown, ...axes.map((axis) => column(axis, axis.x.map((x, k) => x - axis.set[k])))]);
    axes.forEach(({ rms }, k) => say(legend.children[k].lastChild, `${fixed(rms, 2)} mm`));
    say(words, `Root mean square of the error over ${SPAN_S} s, beside each name.`);
  }

  async function update() {
    if (isAsking) return;
    isAsking = true;
    const found = await ask("tracking", live.tracking());
    isAsking = false;
    if (found?.tracking) show(found.tracking);
  }

  const unTheme = onTheme(() => { key = ""; update(); });
  const timer = setInterval(update, REFRESH_MS);
  update();
  return { element, close: () => { clearInterval(timer); unTheme(); charts.forEach((chart) => chart.close()); } };
}
