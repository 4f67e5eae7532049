// Spans of time: which intervals they are read in, and how they are kept in a URL. Pure.

const S = 1000, MIN = 60 * S, HOUR = 60 * MIN, DAY = 24 * HOUR;
export const SPANS = [[MIN, "1 min"], [10 * MIN, "10 min"], [HOUR, "1 h"], [8 * HOUR, "8 h"], [DAY, "1 d"], [7 * DAY, "7 d"], [30 * DAY, "30 d"]];
export const SHORTEST = 10 * S, LONGEST = 30 * DAY;
export const STEPS = [100, 200, 500, S, 2 * S, 5 * S, 10 * S, 30 * S, MIN, 2 * MIN, 5 * MIN, 10 * MIN, 30 * MIN, HOUR, 2 * HOUR, 4 * HOUR];
const AFAR_MS = 10 * S;
const FEWEST = 360; // intervals of a picture: each is drawn with its least and largest value

/** The longest interval that still gives a fine picture of a span, ms. */
export const stepOf = (span) => STEPS.findLast((step) => span / step >= FEWEST) ?? STEPS[0];

/** Whether intervals are so long that one value a second fills them; what is in between follows from the history. */
export const isFromAfar = (span) => stepOf(span) >= AFAR_MS;

export const bounded = (span) => Math.min(Math.max(span, SHORTEST), LONGEST);

/** {span, end (null: now), other, before, at (null: where the pointer is)} of a URL's query, in ms. */
export function readSpan(query) {
  const span = Number(query.get("span")), end = Number(query.get("end")), before = Number(query.get("before")), at = Number(query.get("at"));
  return { span: span > 0 ? bounded(span * S) : 10 * MIN, end: end > 0 ? end * S : null, other: query.get("with") ?? "", before: before > 0 ? before * S : 0, at: at > 0 ? at * S : null };
}

export function writeSpan({ span, end, other, before, at }) {
  const query = new URLSearchParams({ span: String(Math.round(span / S)) });
  if (end !== null) query.set("end", String(Math.round(end / S)));
  if (other) query.set("with", other);
  if (before) query.set("before", String(before / S));
  if (at !== null) query.set("at", String(Math.round(at / S)));
  return query;
}
