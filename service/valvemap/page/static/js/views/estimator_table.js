// The estimators of a valve side by side.

import { h, lineVariable, mark, say } from "../dom.js";
import { fixed, STATUS } from "../format.js";
import { decimals as decimalsOf, shown as shownUnit, spreadShown } from "../units.js";

/** The table; `quantities` are its columns, `onSelect` is told the estimator that is chosen. */
export function estimatorTable(estimators, quantities, onSelect) {
  const rows = estimators.map((name, k) => h("tr", { "data-estimator": name },
    h("td", {}, h("button", { type: "button", onclick: () => onSelect(name), "aria-label": `Show ${name}` },
      h("i.swatch", { style: { "--c": lineVariable(k) } }), name)),
    h("td"), quantities.map(() => h("td.number"))));
  const element = h("table.estimators", {},
    h("thead", {}, h("tr", {}, h("th", {}, `in ${shownUnit("l/min")}`), h("th", {}, "Status"), quantities.map(({ heading, about }) => h("th.number", { title: about }, heading)))),
    h("tbody", {}, rows));
  return {
    element,
    rows,
    show(live, selected, old) {
      const best = live.get("Recommended")?.value;
      estimators.forEach((name, k) => {
        const of = (what) => live.number(`${name}.${what}`), cells = rows[k].cells;
        const chosen = String(name === selected);
        if (rows[k].getAttribute("aria-selected") !== chosen) rows[k].setAttribute("aria-selected", chosen);
        mark(rows[k], "best", name === best);
        say(cells[1], old ? "not known" : STATUS[of("Status")]?.[0] ?? "–");
        quantities.forEach(({ name: what, decimals, unit }, j) => say(cells[j + 2], unit === "l/min" ? fixed(spreadShown(of(what), unit), decimalsOf(unit, decimals)) : fixed(of(what), decimals)));
      });
    },
  };
}
