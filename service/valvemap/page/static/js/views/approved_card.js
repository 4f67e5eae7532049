// The present map against the approved one: approve it, or go back.

import { writer } from "../controls.js";
import { h, say } from "../dom.js";
import { clock, fixed, inUnit, spreadInUnit } from "../format.js";
import { told } from "../trust.js";
import { shown } from "../units.js";

const COMPARE_MS = 10000; // between two comparisons
const FIRST_MS = 1500; // the version is read by then
const SHOW_MS = 1000; // a valve that falls silent sends nothing that would draw it

/** The card; `onShow` draws both maps. */
export function approvedCard({ live, ask, user, valve, onShow }) {
  let selected = valve.primary, comparison = null;
  const words = h("p"), done = h("p.words", { role: "status" }), hint = h("p.words");
  const both = h("button.quiet", { type: "button", onclick: onShow }, "Show both maps");
  const asks = (what) => ({ of: valve.name, command: () => ({ baseline: valve.name, do: what }), does: () => act(what) });
  const approve = writer("Approve this map", asks("Approve"));
  const rollBack = writer("Keep the approved one", { ...asks("RollBack"), look: ".quiet", idle: "No map is approved yet.", command: () => (live.get("Baseline.Version")?.value ? { baseline: valve.name, do: "RollBack" } : null) });
  const element = h("section.card.before", {}, h("header", {}, h("h2", {}, "Against the approved map")), words, h("div.buttons", {}, both, hint, rollBack.button, approve.button), done);

  async function compare() {
    const found = await ask("compare", live.get("Baseline.Version")?.value && !live.old ? live.compare(valve.name, selected) : { error: "" });
    if (!found) return;
    comparison = found.error === undefined ? found : null;
    show();
  }

  function show() {
    const version = live.get("Baseline.Version")?.value, when = live.number("Baseline.Time"), unit = shown("l/min"), old = live.oldOf(valve.name);
    const name = `version ${version}${when > 0 ? `, ${clock(when)}` : ""}`;
    if (old) say(words, `Not known: ${told(old)}`);
    else if (!version) say(words, "No map is approved yet. Approve one when the valve is new: later maps are compared with it.");
    else if (!comparison) say(words, `Approved: ${name}. The comparison is not known.`);
    else if (!comparison.points) say(words, `Approved: version ${version}. Both maps rest on measurements at no common point yet.`);
    else {
      const since = live.number(`${selected}.ChangeCount`) > 0 ? ` The last abrupt change was at ${clock(live.number(`${selected}.ChangeTime`))}.` : "";
      say(words, `Now minus approved (${name}): ${spreadInUnit(comparison.mean, "l/min", 1)} ${unit} on average; largest ${spreadInUnit(comparison.largest, "l/min", 1)} ${unit} at U ${fixed(comparison.U, 0)} %, Δp ${inUnit(comparison.dp, "bar", 0)} ${shown("bar")}; ${comparison.points} points.${since}`);
    }
    both.hidden = !version;
    say(hint, user.name || old ? approve.why() : "To approve a map, log in as an operator.");
  }

  async function act(what) {
    const question = what === "Approve" ? "Approve the present maps of all estimators? Later maps are compared with them." : "Go back to the approved map? What all estimators learnt since is dropped.";
    if (!confirm(question)) return;
    const command = { baseline: valve.name, do: what }, problem = await ask(command, user.command(command));
    if (problem === undefined) return;
    say(done, problem ?? { Approve: "Approved.", RollBack: "The estimators are as they were when the map was approved." }[what]);
    compare();
  }

  const comparing = setInterval(compare, COMPARE_MS), first = setTimeout(compare, FIRST_MS), showing = setInterval(show, SHOW_MS);
  for (const what of ["standing", "values"]) live.addEventListener(what, show);
  for (const what of ["change", "rights"]) user.addEventListener(what, show);
  show();
  return {
    element,
    select: (estimator) => { if (estimator !== selected) { selected = estimator; comparison = null; compare(); } },
    close: () => {
      clearInterval(comparing);
      clearInterval(showing);
      clearTimeout(first);
      for (const what of ["standing", "values"]) live.removeEventListener(what, show);
      for (const what of ["change", "rights"]) user.removeEventListener(what, show);
    },
  };
}
