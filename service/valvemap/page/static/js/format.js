// Numbers and times as people read them; the width of a number does not depend on its digits.

import { decimals, spreadShown, toShown } from "./units.js";

export { clock } from "./times.js";

export const NAN = "–";
export const KINDS = { status: "state", change: "change", alarm: "alarm", action: "action", link: "service" }; // of events

/** A number with a fixed count of decimals; a true minus sign. */
export function fixed(value, decimals = 1) {
  if (!Number.isFinite(value)) return NAN;
  const text = value.toFixed(decimals);
  return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", "−");
}

/** A number of unknown size with about four digits. */
export function short(value) {
  if (!Number.isFinite(value)) return NAN;
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-3 || size >= 1e6)) return value.toExponential(2).replace("-", "−");
  return fixed(value, size >= 100 ? 1 : size >= 1 ? 3 : 5);
}

export function count(value) {
  return Number.isFinite(value) ? Math.round(value).toLocaleString("en").replaceAll(",", " ") : NAN;
}

/** 1 alarm, 2 alarms. */
export const counted = (n, word) => `${n} ${word}${n === 1 ? "" : "s"}`;

/** A span of time in its own unit. */
export function span(seconds) {
  if (!Number.isFinite(seconds)) return NAN;
  if (seconds < 10) return `${fixed(Math.max(seconds, 0), 1)} s`;
  if (seconds < 120) return `${Math.round(seconds)} s`;
  if (seconds < 7200) return `${Math.round(seconds / 60)} min`;
  if (seconds < 172800) return `${Math.round(seconds / 3600)} h`;
  return `${Math.round(seconds / 86400)} d`;
}

// Filled with the service's own words when the page connects: [label, sentence], for the inverse
// [severity, sentence], by number, of reasons also whether the values are old; of signals [caption, unit], by name.
export const STATUS = [], ADAPTATION = [], INVERSE_STATUS = [], REASONS = [], SIGNALS = {};
export const HEALTH = []; // by NAMUR NE 107: [label, sentence]
export const GUIDES = {}; // of alarms, by name: [quantity, what to do]
export const CODES = {}; // of lines and axes: by kind and variable, by number, [severity, label, sentence]

export function learnWords({ status, adaptation, inverse, reason, signals, health, guides, codes }) {
  Object.assign(SIGNALS, signals);
  Object.assign(CODES, codes);
  Object.assign(GUIDES, guides);
  [[STATUS, status], [ADAPTATION, adaptation], [INVERSE_STATUS, inverse], [REASONS, reason], [HEALTH, health]].forEach(([kept, words]) => kept.splice(0, Infinity, ...words));
}

/** SensorFrozen → Sensor frozen. */
export const spaced = (name) => name.replace(/(?<=[a-z])[A-Z]/g, (capital) => ` ${capital.toLowerCase()}`);

/** A number of the service's unit, in the unit in use, without that unit. */
export const inUnit = (value, unit, usual) => fixed(toShown(value, unit), decimals(unit, usual));
export const spreadInUnit = (value, unit, usual) => fixed(spreadShown(value, unit), decimals(unit, usual));
