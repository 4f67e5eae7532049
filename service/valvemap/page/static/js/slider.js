// A quantity to choose: a slider, and a field for the exact number in the unit in use.

import { h } from "./dom.js";
import { decimals, fromShown, shown, toShown } from "./units.js";

export function slider(title, unit, min, max, step, value, onChange = () => {}) {
  const id = `s${Math.random().toString(36).slice(2)}`, digits = decimals(unit, step < 1 ? 1 : 0);
  const input = h("input", { id, type: "range", min, max, step, value });
  const [low, high] = [min, max].map((end) => Number(toShown(end, unit).toFixed(digits)));
  const field = h("input", { type: "number", min: low, max: high, step: "any", "aria-label": `${title} in ${shown(unit)}` });
  let chosen = value;

  function write(isTyped = false) {
    const text = toShown(chosen, unit).toFixed(digits);
    if (!isTyped) field.value = text;
    input.setAttribute("aria-valuetext", `${text} ${shown(unit)}`);
  }

  input.addEventListener("input", () => { chosen = Number(input.value); write(); onChange(chosen); });
  field.addEventListener("input", () => {
    if (!Number.isFinite(field.valueAsNumber)) return;
    chosen = Math.min(Math.max(fromShown(field.valueAsNumber, unit), min), max);
    input.value = chosen;
    write(true);
    onChange(chosen);
  });
  field.addEventListener("change", () => write());
  write();
  return {
    element: h("div.slider", {}, h("label", { for: id }, title), input, h("span.exact", {}, field, h("span.muted", {}, shown(unit)))),
    inputs: [input, field],
    get value() { return chosen; },
    set: (to) => { chosen = to; input.value = to; write(); },
  };
}
