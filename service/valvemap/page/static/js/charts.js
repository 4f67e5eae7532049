// Charts over time, and what all charts share.

import uPlot from "../vendor/uplot/uPlot.esm.js";
import { css } from "./dom.js";

const SECONDS = 60; // in view of a live chart
export const SECOND_AXIS = 64; // px that an axis on the right takes; without one, charts keep them free to lie above each other
const GAP_S = 2; // no line is drawn over a longer silence
const DAY_S = 86400;

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

const FONT = "12px system-ui, sans-serif";

function axis(label, extra = {}) {
  return {
    stroke: () => css("--soft"), grid: { stroke: () => css("--line"), width: 1 }, ticks: { show: false },
    font: FONT, label, labelFont: FONT, labelSize: 18, size: 46, values: numberTicks, ...extra,
  };
}

function line({ label, colour, width = 1.5, dash = [], scale = "y", dots = false, size = 4, spanGaps = false }) {
  return {
    label, width: width || 1, scale, dash, spanGaps, stroke: width ? () => css(colour) : "transparent",
    points: { show: dots, size, width: 0, fill: () => css(colour) }, ...(dots ? { paths: () => null } : {}),
  };
}

const filled = (bands) => bands.map(([upper, lower, colour, share = "26"]) => ({ series: [upper, lower], fill: () => `${css(colour)}${share}` }));

/** A chart as wide as its parent, and as high unless a height is given. */
function fitted(parent, height, options, data) {
  const size = () => ({ width: parent.clientWidth || 300, height: height ?? Math.max(parent.clientHeight, 90) });
  const chart = new uPlot({ ...size(), ...options }, data, parent);
  const resize = new ResizeObserver(() => {
    const wanted = size();
    if (parent.clientWidth && (wanted.width !== chart.width || wanted.height !== chart.height)) chart.setSize(wanted);
  });
  resize.observe(parent);
  return { chart, close: () => { resize.disconnect(); chart.destroy(); } };
}

const seconds = new Intl.DateTimeFormat("en-GB", { hour: "2-digit", minute: "2-digit", second: "2-digit" });
const minutes = new Intl.DateTimeFormat("en-GB", { hour: "2-digit", minute: "2-digit" });
const days = new Intl.DateTimeFormat("en-GB", { day: "numeric", month: "short" });

/** The minute before a time in s; before now while there are no data. */
function newest(max) {
  const end = max > 0 ? max : Date.now() / 1000;
  return [end - SECONDS, end];
}

function timeTicks(chart, ticks) {
  const step = ticks.length > 1 ? ticks[1] - ticks[0] : 1;
  return ticks.map((t) => {
    const date = new Date(t * 1000);
    if (step >= DAY_S || (date.getHours() === 0 && date.getMinutes() === 0 && step >= 600)) return days.format(date);
    return (step < 60 ? seconds : minutes).format(date);
  });
}

const number = new Intl.NumberFormat("en-GB", { maximumFractionDigits: 9, useGrouping: false });

/** Numbers as everywhere on the page, whatever the browser's language. */
const numberTicks = (chart, ticks) => ticks.map((x) => (x === null ? "" : number.format(x).replace("-", "−")));

/** Shade a chart behind its lines, over spans [from, to] of its first axis. */
export function shadeSpans(chart, spans, colour) {
  const { ctx, bbox } = chart, place = (x) => Math.min(Math.max(chart.valToPos(x, "x", true), bbox.left), bbox.left + bbox.width);
  ctx.save();
  ctx.fillStyle = colour;
  for (const [from, to] of spans) if (to >= chart.scales.x.min && from <= chart.scales.x.max) ctx.fillRect(place(from), bbox.top, Math.max(place(to) - place(from), 1), bbox.height);
  ctx.restore();
}

/** A chart of the newest minute, or of `span` [from, to] in s. series: [{label, colour, width, dash, scale}]; bands: [[upper, lower, fill]]. */
export function timeChart(parent, height, series, { unit, unit2, bands = [], range, right = 12, span, cursor = {}, hooks = {} } = {}) {
  return fitted(parent, height, {
    padding: [8, unit2 ? 0 : right, 0, 0], legend: { show: false },
    cursor: { drag: { x: false, y: false }, points: { size: 6 }, ...cursor },
    scales: {
      x: { time: true, range: (_, __, max) => span?.() ?? newest(max) },
      y: range ? { range } : {},
      ...(unit2 ? { second: {} } : {}),
    },
    axes: [
      axis(null, { size: 26, labelSize: 0, space: 90, values: timeTicks }), axis(unit),
      ...(unit2 ? [axis(unit2, { scale: "second", side: 1, grid: { show: false } })] : []),
    ],
    series: [{}, ...series.map(line)], bands: filled(bands), hooks,
  }, [[], ...series.map(() => [])]);
}

/** A chart over a number; data are set with chart.setData. */
export function lineChart(parent, height, series, { x, y, bands = [], xRange, hooks = {} } = {}) {
  return fitted(parent, height, {
    padding: [8, 14, 0, 0], legend: { show: false }, cursor: { drag: { x: false, y: false } },
    scales: { x: { time: false, ...(xRange ? { range: xRange } : {}) } },
    axes: [axis(x, { size: 30 }), axis(y)],
    series: [{}, ...series.map(({ points = false, ...of }) => line({ ...of, dots: points, size: 5, spanGaps: !points }))],
    bands: filled(bands), hooks,
  }, [[], ...series.map(() => [])]);
}
