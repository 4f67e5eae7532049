// Charts over time, and what all charts share.

import uPlot from "../vendor/uplot/uPlot.esm.js";
import { css } from "./dom.js";

const SECONDS = 60; // in view
export const SECOND_AXIS = 64; // px that an axis on the right takes; without one, charts keep them free to lie above each other
const GAP_S = 2; // no line is drawn over a longer silence

/** A ring of rows (time in s first), the newest last. */
export class History {
  constructor(columns, most = 900) {
    this.most = most;
    this.data = Array.from({ length: columns + 1 }, () => []);
  }

  get last() { return this.data[0].at(-1) ?? -Infinity; }

  add(t, values) {
    if (!(t > this.last)) return;
    if (t > this.last + GAP_S && this.data[0].length) this.#push(this.last + GAP_S / 2, []);
    this.#push(t, values);
  }

  #push(t, values) {
    const [times, ...columns] = this.data;
    times.push(t);
    columns.forEach((column, k) => column.push(Number.isFinite(values[k]) ? values[k] : null));
    if (times.length > this.most) for (const column of this.data) column.splice(0, column.length - this.most);
  }

  clear() { for (const column of this.data) column.length = 0; }
}

/** A chart of the newest minute. series: [{label, colour, width, dash, scale, fill}]; bands: [[upper, lower, fill]]. */
export function timeChart(parent, height, series, { unit, unit2, bands = [], range, right = 12 } = {}) {
  const axis = (label, extra = {}) => ({
    stroke: () => css("--soft"), grid: { stroke: () => css("--line"), width: 1 }, ticks: { show: false },
    font: "12px system-ui, sans-serif", label, labelFont: "12px system-ui, sans-serif", labelSize: 18, size: 46, ...extra,
  });
  const clock = new Intl.DateTimeFormat("en-GB", { hour: "2-digit", minute: "2-digit", second: "2-digit" });
  const options = {
    width: parent.clientWidth || 300, height, padding: [8, unit2 ? 0 : right, 0, 0],
    legend: { show: false },
    cursor: { drag: { x: false, y: false }, points: { size: 6 } },
    scales: {
      x: { time: true, range: (_, __, max) => [max - SECONDS, max] },
      y: range ? { range } : {},
      ...(unit2 ? { second: {} } : {}),
    },
    axes: [
      axis(null, { size: 26, labelSize: 0, space: 90, values: (_, ticks) => ticks.map((t) => clock.format(new Date(t * 1000))) }),
      axis(unit),
      ...(unit2 ? [axis(unit2, { scale: "second", side: 1, grid: { show: false } })] : []),
    ],
    series: [
      {},
      ...series.map(({ label, colour, width = 1.5, scale = "y", dots = false }) => ({
        label, width: width || 1, scale, stroke: width ? () => css(colour) : "transparent",
        points: { show: dots, size: 4, width: 0, fill: () => css(colour) }, ...(dots ? { paths: () => null } : {}),
      })),
    ],
    bands: bands.map(([upper, lower, colour]) => ({ series: [upper, lower], fill: () => `${css(colour)}26` })),
  };
  const chart = new uPlot(options, [[], ...series.map(() => [])], parent);
  const resize = new ResizeObserver(() => {
    if (parent.clientWidth && parent.clientWidth !== chart.width) chart.setSize({ width: parent.clientWidth, height });
  });
  resize.observe(parent);
  return { chart, close: () => { resize.disconnect(); chart.destroy(); } };
}

/** A chart over a number; data are set with chart.setData. */
export function lineChart(parent, height, series, { x, y, bands = [], xRange } = {}) {
  const axis = (label) => ({
    stroke: () => css("--soft"), grid: { stroke: () => css("--line"), width: 1 }, ticks: { show: false },
    font: "12px system-ui, sans-serif", label, labelFont: "12px system-ui, sans-serif", labelSize: 18, size: label === x ? 30 : 46,
  });
  const chart = new uPlot({
    width: parent.clientWidth || 300, height, padding: [8, 14, 0, 0], legend: { show: false },
    cursor: { drag: { x: false, y: false } },
    scales: { x: { time: false, ...(xRange ? { range: xRange } : {}) } },
    axes: [axis(x), axis(y)],
    series: [
      {},
      ...series.map(({ label, colour, width = 1.5, dash = [], points = false }) => ({
        label, width: width || 1, dash, spanGaps: !points, stroke: width ? () => css(colour) : "transparent",
        points: { show: points, size: 5, fill: () => css(colour) }, ...(points ? { paths: () => null } : {}),
      })),
    ],
    bands: bands.map(([upper, lower, colour]) => ({ series: [upper, lower], fill: () => `${css(colour)}26` })),
  }, [[], ...series.map(() => [])], parent);
  const resize = new ResizeObserver(() => {
    if (parent.clientWidth && parent.clientWidth !== chart.width) chart.setSize({ width: parent.clientWidth, height });
  });
  resize.observe(parent);
  return { chart, close: () => { resize.disconnect(); chart.destroy(); } };
}
