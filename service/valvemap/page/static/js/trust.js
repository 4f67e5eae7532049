// How far what is shown can be trusted: one state, which every view and every button that writes reads.

import { clock, REASONS, span } from "./format.js";

export const STALE_S = 3; // without a new sample, a valve's numbers are old

const LINKS = {
  connecting: { why: "The page is still connecting to the service.", advice: "Wait some seconds." },
  lost: { why: "The service does not answer.", advice: "Check that it runs, and the network between." },
  refused: { why: "The service refuses this page.", advice: "Check the page's certificate and its user at the service: valvemap trust." },
  page: { why: "This page's server does not answer.", advice: "Check that valvemap dashboard runs, and the network." },
};
const SILENT = { state: "valve", label: "no new samples", why: "No new sample arrives.", advice: "Check the source of its signals." };

/** Nothing is of now while the link is in this state. */
export const oldLink = (state, since) => ({ state, label: "not known", ...LINKS[state], since });

/** Nothing of a valve or line is of now, by its row of the overview; null while it is. `start`: how far the service's start is, if it is not over. */
export function oldRow({ reason, since, silent }, start) {
  const [label, why, isOld] = REASONS[reason];
  if (start && (isOld || silent > STALE_S)) return { state: "valve", isStart: true, label: "starting", why: "The service has not started completely.", since: Date.now() - 1000 * silent, advice: `Wait: ${start}.` };
  if (isOld) return { state: "valve", label, why, since, advice: "See Alarms for what to do." };
  return silent > STALE_S ? { ...SILENT, since: Date.now() - 1000 * silent } : null;
}

/** The same of an axis, which has no row: by the age of its newest value in s, and whether that is Bad. */
export function oldPart(t, silent, isBad) {
  return isBad || silent > STALE_S ? { ...SILENT, since: t || Date.now() - 1000 * silent } : null;
}

/** Why it is not of now, since when, what to do. */
export const told = ({ why, since, advice }) => `${why}${since ? ` Since ${clock(since)}, for ${span((Date.now() - since) / 1000)}.` : ""} ${advice}`;

/** How a valve or line stands: {old, severity, label, sentence, since}; `known` is what its newest values say, as [severity, label, sentence]. */
export function standingOf(live, name, known = null) {
  const old = live.oldOf(name), row = live.rowOf(name);
  if (old) return { old, severity: 3, label: old.label, sentence: told(old), since: old.since };
  const [severity, label, sentence] = known ?? (row ? [row.severity, ...REASONS[row.reason]] : [1, "not known yet", ""]);
  return { old: null, severity, label, sentence, since: row?.since };
}
