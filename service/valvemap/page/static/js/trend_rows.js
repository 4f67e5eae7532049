// Intervals of a trend as columns of a chart: read from the history, continued with live values. Pure.

import { stepOf } from "./spans.js";
import { spreadShown, toShown } from "./units.js";

const GAP_STEPS = 3, GAP_MS = 3000; // no line is drawn over a longer silence
const LATEST_MS = 3600e3; // a live value of another time is not of this trend

const gapOf = (step) => Math.max(GAP_STEPS * step, GAP_MS) / 1000;

const shownOf = (value, [, , unit, , isSpread]) => (isSpread ? spreadShown(value, unit) : toShown(value, unit));

/** No intervals yet, of `series` [name, caption, unit, colour, spread]. */
export const emptyRows = (series, span) => ({ t: [], of: series.map(() => [[], [], []]), step: stepOf(span), newest: 0, count: 0, silences: [], isTorn: false });

/** What was read: intervals without any value are left out; a long silence is a gap, and kept as [from, to] in ms. */
export function tabled(series, found, shift = 0) {
  const made = { ...emptyRows(series, 0), step: found.step }, n = found.courses[0]?.[0].length ?? 0, gap = gapOf(found.step);
  for (let k = 0; k < n; k++) {
    if (!found.courses.some(([mean]) => Number.isFinite(mean[k]))) continue;
    const t = (found.start + shift + (k + 0.5) * found.step) / 1000, last = made.t.at(-1);
    if (last !== undefined && t - last > gap) {
      made.silences.push([1000 * last + found.step / 2, 1000 * t - found.step / 2]);
      addEmpty(made, (last + t) / 2);
    }
    made.t.push(t);
    series.forEach((one, c) => found.courses[c].forEach((of, j) => made.of[c][j].push(Number.isFinite(of[k]) ? shownOf(of[k], one) : null)));
  }
  made.newest = (made.t.at(-1) ?? 0) * 1000 + found.step / 2 - shift;
  return made;
}

/** Spans of equal status codes in course `of`: {from, to, code, isPart} in ms. Of several codes within one interval, the largest is shown, as a part. */
export function codeSpans(found, of) {
  const spans = [], [, least, largest] = found.courses[of] ?? [[], [], []];
  largest.forEach((code, k) => {
    if (!Number.isFinite(code)) return;
    const from = found.start + k * found.step, to = from + found.step, isPart = least[k] !== code, last = spans.at(-1);
    if (last?.code === code && last.isPart === isPart && from - last.to <= GAP_STEPS * found.step) last.to = to;
    else spans.push({ from, to, code, isPart });
  });
  return spans;
}

/** Spans in which course `of` was 0 certain, 1 partly, 2 not at all: {from, to, doubt} in ms; none where no course has a value. */
export function doubtSpans(found, of) {
  const spans = [], n = found.doubts[of]?.length ?? 0;
  for (let k = 0; k < n; k++) {
    if (!found.courses.some(([mean]) => Number.isFinite(mean[k]))) continue;
    const from = found.start + k * found.step, to = from + found.step, doubt = found.doubts[of][k], last = spans.at(-1);
    if (last?.doubt === doubt && from - last.to <= GAP_STEPS * found.step) last.to = to;
    else spans.push({ from, to, doubt });
  }
  return spans;
}

/** Means of columns `U` and `dp` of the intervals within [from, to] in ms, and the doubt of each, undefined where none is known. */
export function pointsOf(rows, [U, dp], doubts, [from, to]) {
  const points = [];
  let k = 0;
  rows.t.forEach((t, i) => {
    const at = 1000 * t;
    if (at < from || at > to) return;
    while (k < doubts.length && doubts[k].to <= at) k++;
    points.push({ U: rows.of[U][0][i], dp: rows.of[dp][0][i], doubt: doubts[k]?.from <= at ? doubts[k].doubt : undefined });
  });
  return points;
}

function addEmpty(rows, t) {
  rows.t.push(t);
  rows.of.forEach((columns) => columns.forEach((column) => column.push(null)));
}

/** Add the newest values (in the service's units), of time `at` in ms. What lies between these and what was read is not known yet. */
export function addNewest(rows, series, values, at) {
  if (!at || at <= rows.newest || Math.abs(Date.now() - at) > LATEST_MS || !values.some(Number.isFinite)) return;
  rows.newest = at;
  const place = (Math.floor(Date.now() / rows.step) * rows.step + rows.step / 2) / 1000, last = rows.t.length - 1;
  if (rows.t[last] > place) return;
  if (rows.t[last] !== place) {
    if (place - rows.t[last] > gapOf(rows.step)) {
      addEmpty(rows, (rows.t[last] + place) / 2);
      rows.isTorn = true;
    }
    addEmpty(rows, place);
    rows.count = 0;
  }
  rows.count = (rows.count ?? 1) + 1;
  const k = rows.t.length - 1;
  values.forEach((of, c) => {
    if (!Number.isFinite(of)) return;
    const value = shownOf(of, series[c]), [mean, least, largest] = rows.of[c];
    mean[k] = mean[k] === null ? value : mean[k] + (value - mean[k]) / rows.count;
    least[k] = least[k] === null ? value : Math.min(least[k], value);
    largest[k] = largest[k] === null ? value : Math.max(largest[k], value);
  });
}

/** Columns over the common times of two tables. */
export function joined(t, columns, otherT, other) {
  if (!otherT?.length) return [t, ...columns, t.map(() => null)];
  const times = [...new Set([...t, ...otherT])].sort((a, b) => a - b);
  const place = new Map(t.map((at, k) => [at, k])), otherPlace = new Map(otherT.map((at, k) => [at, k]));
  return [times, ...columns.map((column) => times.map((at) => (place.has(at) ? column[place.get(at)] : undefined))), times.map((at) => (otherPlace.has(at) ? other[otherPlace.get(at)] : undefined))];
}
