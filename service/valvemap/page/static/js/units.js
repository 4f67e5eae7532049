// Units by the user's choice, kept in the browser. The service computes in bar, l/min and °C.

import { inLocalTime } from "./times.js";

const CHOICES = {
  pressure: { of: "bar", units: { bar: [1, 0], psi: [14.503773773, 0], MPa: [0.1, 0] } },
  flow: { of: "l/min", units: { "l/min": [1, 0], gpm: [0.26417205236, 0], "m³/h": [0.06, 0] } },
  temperature: { of: "°C", units: { "°C": [1, 0], "°F": [1.8, 32] } },
};
const KIND = Object.fromEntries(Object.entries(CHOICES).map(([kind, { of }]) => [of, kind]));
const IN_TEXT = /([+\-−]?\d[\d,]*(?:\.\d+)?(?:e[+-]?\d+)?)( ?)(l\/min|bar|°C)(?![\w/])/g;

let chosen = {};
try { chosen = JSON.parse(localStorage.getItem("units")) ?? {}; } catch { /* what is kept there is not ours */ }

const known = (kind) => (CHOICES[kind].units[chosen[kind]] ? chosen[kind] : CHOICES[kind].of);

/** [kind, unit in use, units to choose from] of each. */
export const choices = () => Object.entries(CHOICES).map(([kind, { units }]) => [kind, known(kind), Object.keys(units)]);

export function choose(kind, unit) {
  chosen = { ...chosen, [kind]: unit };
  localStorage.setItem("units", JSON.stringify(chosen));
  dispatchEvent(new Event("units"));
}

/** The unit in which a quantity of the service's `unit` is shown. */
export const shown = (unit) => (KIND[unit] ? known(KIND[unit]) : unit);

const scale = (unit) => (KIND[unit] ? CHOICES[KIND[unit]].units[known(KIND[unit])] : [1, 0]);

export function toShown(value, unit) {
  const [factor, offset] = scale(unit);
  return value * factor + offset;
}

export function fromShown(value, unit) {
  const [factor, offset] = scale(unit);
  return (value - offset) / factor;
}

/** A difference or a standard deviation: without the offset of a scale. */
export const spreadShown = (value, unit) => value * scale(unit)[0];

/** As many decimals as show the same steps. */
export function decimals(unit, usual) {
  return Math.max(usual - Math.round(Math.log10(scale(unit)[0])), 0);
}

/** A sentence of the service, with its numbers in the units in use, and its times in the browser's zone. */
export function inUnits(text) {
  return inLocalTime(text).replace(IN_TEXT, (whole, digits, space, unit) => {
    if (shown(unit) === unit) return whole;
    const value = Number(digits.replace("−", "-").replaceAll(",", ""));
    const isSpread = /^[+]/.test(digits) || unit !== "°C" ? spreadShown(value, unit) : toShown(value, unit);
    const sign = /^\+/.test(digits) && isSpread >= 0 ? "+" : "";
    return `${sign}${Number(isSpread.toPrecision(3))}${space}${shown(unit)}`.replace("-", "−");
  });
}
