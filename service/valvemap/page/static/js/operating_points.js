// Where a valve worked in a span of a trend: control voltage and pressure drop of its intervals.

import { lineChart } from "./charts.js";
import { h, say } from "./dom.js";
import { fixed } from "./format.js";
import { shown } from "./units.js";

const UNCERTAIN = 1; // doubt of an interval: 0 all results Good, 1 some, 2 none

/** A card; `draw(points)` takes {U, dp, doubt} of each interval, in the units shown. */
export function operatingPoints() {
  const body = h("div.chart.fit"), words = h("p.words");
  const legend = h("div.legend", {}, [["ok", "--line-1"], ["uncertain", "--warning"]].map(([name, colour]) => h("span", {}, h("i.dot", { style: { "--c": `var(${colour})` } }), name)));
  const element = h("section.card.stack.points", { "aria-label": "Operating points" }, h("header", {}, h("h2", {}, "Operating points in this span"), h("span.fill"), legend), body, words);
  const { chart, close } = lineChart(body, null, [{ label: "ok", colour: "--line-1", points: true }, { label: "uncertain", colour: "--warning", points: true }],
    { x: "U in %", y: `Δp in ${shown("bar")}` });

  function draw(points) {
    const found = points.filter(({ U, dp }) => U !== null && dp !== null).sort((a, b) => a.U - b.U);
    const of = (isMeant) => found.map(({ dp, doubt }) => (isMeant(doubt) ? dp : null));
    chart.setData([found.map(({ U }) => U), of((doubt) => !(doubt >= UNCERTAIN)), of((doubt) => doubt >= UNCERTAIN)]);
    const dps = found.map(({ dp }) => dp);
    say(words, found.length ? `U ${fixed(found[0].U, 0)} to ${fixed(found.at(-1).U, 0)} %, Δp ${fixed(Math.min(...dps), 0)} to ${fixed(Math.max(...dps), 0)} ${shown("bar")}, each point the mean of an interval.` : "No samples in this span.");
  }

  return { element, draw, close };
}
