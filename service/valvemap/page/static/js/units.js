// Units by the user's choice, kept in the browser. The service computes in bar, l/min and °C.

import { inLocalTime } from "./times.js";

const CHOICES = {
  pressure: { of: "bar", units: { bar: [1, 0], psi: [14.503773773, 0], MPa: [0.1, 0] } },
  flow: { of: "l/min", units: { "l/min": [1, 0], gpm: [0.26417205236, 0], "m³/h": [0.06, 0] } },
  temperature: { of: "°C", units: { "°C": [1, 0], "°F": [1.8, 32] } },
};
const KIND = Object.fromEntries(Object.entries(CHOICES).map(([kind, { of }]) => [of, kind]));
const PART = /(\/?)(√?)(\(?)(?<!\w)(l\/min|bar|°C)(?!\w)\)?/g; // of a unit such as (l/min)/√bar
const NUMBER = String.raw`[+\-−]?\d[\d,]*(?:\.\d+)?(?:e[+-]?\d+)?`, BETWEEN = " (?:to|…|±) "; // numbers that share a unit
const IN_TEXT = new RegExp(String.raw`(?<![\w.,:])(?<spread>± ?)?(?<numbers>(?:${NUMBER}${BETWEEN})*${NUMBER})(?<space> ?)(?<unit>(?:l\/min|\(l\/min\)(?=\/))(?:\/√?bar)?|bar(?:\/s)?|°C)(?![\w/])`, "g");
const ASCII_MINUS = /(?<![\w.,:)\]-])-(?=\d)/g;
const EACH = new RegExp(`(?<before>± ?)?(?<digits>${NUMBER})`, "g");

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

/** The unit in which a quantity of the service's `unit` is shown, also of one made of several. */
export function shown(unit) {
  if (KIND[unit]) return known(KIND[unit]);
  return unit.replace(PART, (whole, over, root, open, of) => {
    const own = shown(of);
    return own === of ? whole : `${over}${root}${open && own.includes("/") ? `(${own})` : own}`;
  });
}

function scale(unit) {
  if (KIND[unit]) return CHOICES[KIND[unit]].units[known(KIND[unit])];
  let factor = 1;
  for (const [, over, root, , of] of unit.matchAll(PART)) factor *= scale(of)[0] ** ((over ? -1 : 1) * (root ? 0.5 : 1));
  return [factor, 0];
}

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
  return inLocalTime(text).replace(ASCII_MINUS, "−").replace(IN_TEXT, (whole, ...found) => {
    const { spread, numbers, space, unit } = found.at(-1);
    if (shown(unit) === unit) return whole;
    const each = `${spread ?? ""}${numbers}`.replace(EACH, (_, ...parts) => {
      const { before = "", digits } = parts.at(-1), isSpread = before || digits.startsWith("+");
      const value = Number(digits.replace("−", "-").replaceAll(",", "")), own = (isSpread ? spreadShown : toShown)(value, unit);
      return `${before}${digits.startsWith("+") && own >= 0 ? "+" : ""}${String(Number(own.toPrecision(3))).replace("-", "−")}`;
    });
    return `${each}${space}${shown(unit)}`;
  });
}
