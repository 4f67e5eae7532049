// Numbers and times as people read them; the width of a number does not depend on its digits.

export const NAN = "–";

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

/** Time of day; with the date if that is another one. */
export function clock(ms) {
  if (!ms) return NAN;
  const date = new Date(ms);
  const time = date.toLocaleTimeString("en-GB");
  return date.toDateString() === new Date().toDateString() ? time : `${date.toLocaleDateString("en-GB")} ${time}`;
}

export const UNITS = { U: "%", p1: "bar", p2: "bar", dp: "bar", Q: "l/min", T: "°C" };
export const SIGNAL_NAMES = {
  U: "U control voltage", p1: "p₁ before", p2: "p₂ behind", dp: "Δp", Q: "Q flow", T: "T oil",
};

export const STATUS = ["ok", "warming up", "not excited", "rejected", "frozen", "held", "extrapolating", "failed"];
export const STATUS_SENTENCE = [
  "Follows every sample.",
  "Too few samples yet for all parameters.",
  "The signals hold still; what they do not show is kept.",
  "The newest samples are bad and not used.",
  "Adaptation is switched off.",
  "An update was refused: numbers out of range.",
  "Works where nothing was measured before.",
  "Stopped at an unexpected error; Reset starts it again.",
];
export const INVERSE_STATUS = [
  [0, "U delivers this flow."],
  [2, "The valve cannot pass so much at this pressure drop."],
  [2, "Even closed, the valve passes more than that."],
  [3, "The map falls with U here: no U can be trusted."],
  [1, "The map is not identified here yet."],
  [1, "No number."],
  [2, "Beyond the table: the nearest end is shown."],
  [2, "Extrapolated: nothing was measured near. A guess."],
];
export const REASONS = [
  "ok", "adaptation off", "extrapolating", "not excited", "warming up", "misfit", "held",
  "valve changed", "samples rejected", "no new samples", "sensor failed", "signals lost", "unreadable", "failed",
];
export const REASON_SENTENCES = [
  "Identified, and following.",
  "Adaptation is switched off: the map is kept as it is.",
  "The valve works where nothing was measured before.",
  "The signals hold still; what they do not show is kept.",
  "Too few samples yet to know the whole map.",
  "The structure cannot follow this valve everywhere.",
  "An update would have left the range of numbers; the map is kept.",
  "The valve changed abruptly.",
  "The newest samples are of bad quality and were not used.",
  "No new sample arrives.",
  "A sensor has failed.",
  "There is no connection to the valve's signals.",
  "The service does not show this valve any more.",
  "The estimator stopped at an unexpected error; Reset starts it again.",
];
