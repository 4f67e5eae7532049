// Drives the valve through its range on the operator's command, with an abort button.

import { writer } from "../controls.js";
import { h, mark, say } from "../dom.js";
import { fromShown, inUnits, shown } from "../units.js";
import { user } from "../user.js";

const HEARTBEAT_MS = 100; // the run goes to its safe U where one is late, and ends without one for a second
const MOST_UNANSWERED = 4; // heartbeats
const UNSEEN_MS = 5000; // after a start, until its run is seen
const OVER = [NaN, 0, 6, 7, 8]; // not known, not started, done, aborted, refused
const INTERRUPTED = [0, 7]; // by the end of the service, or aborted
const TEXTS = ["Progress", "Recording"].map((name) => `Commission.${name}`);

/** The card, hidden where the valve cannot be driven; its update, and what ends its heartbeat. */
export function guidedRun({ live, ask, valve }) {
  let beats = 0, unanswered = 0, beating = null, beganAt = 0, hasBegun = false;
  const accuracy = h("input", { type: "number", min: 0, step: 0.1, value: 0, "aria-label": "Accuracy" });
  const unit = h("span.muted");
  const isOver = () => OVER.includes(live.number("Commission.State"));
  const begins = (how) => ({ of: valve.name, idle: "A run is under way.", command: () => (isOver() ? { run: valve.name, do: how, accuracy: fromShown(accuracy.valueAsNumber || 0, "l/min") } : null), does: start });
  const begin = writer("Start", begins("Start")), resume = writer("Resume", begins("Resume"));
  // a run is ended while the service answers, whatever the signals are
  const abort = writer("Abort", { look: ".danger", idle: "No run is under way.", command: () => (isOver() ? null : { run: valve.name, do: "Abort" }), does: act });
  const progress = h("p"), recording = h("p.words"), hint = h("p.words"), problem = h("p.words", { role: "alert" });
  const element = h("section.card.guided-run", {}, h("header", {}, h("h2", {}, "Guided run")),
    h("p.words", {}, "Moves U through its range, within the limits of [valves.commission], until the map is known. This page must stay open and in front: without it the run ends at the safe U."),
    h("p", {}, h("label", {}, "End at ± ", accuracy), " ", unit, " ", begin.button, " ", resume.button, " ", abort.button),
    progress, recording, hint, problem);

  /** A view that is left before the answer comes sends no heartbeat: the run ends by itself. */
  async function start(command) {
    if (!confirm(`${valve.name} will move. Is everybody clear of the machine?`)) return;
    if (!(await act(command))) return;
    [beganAt, hasBegun] = [performance.now(), false];
    beating ??= setInterval(beat, HEARTBEAT_MS);
  }

  async function act(command) {
    const refused = await ask(command, user.command(command));
    if (refused === undefined) return false;
    say(problem, refused ?? "");
    return refused === null;
  }

  /** Only some wait for their answers: they would take the connections that Abort needs. */
  async function beat() {
    if (document.hidden || unanswered >= MOST_UNANSWERED) return;
    unanswered += 1;
    await user.command({ run: valve.name, do: "Heartbeat", count: ++beats });
    unanswered -= 1;
  }

  function end() {
    clearInterval(beating);
    beating = null;
  }

  function update() {
    const state = live.number("Commission.State"), old = live.old, hasEnded = isOver();
    element.hidden = !live.has("Commission.State");
    hasBegun ||= !hasEnded;
    if (beating && hasEnded && (hasBegun || performance.now() - beganAt > UNSEEN_MS)) end();
    say(unit, shown("l/min"));
    resume.button.hidden = !INTERRUPTED.includes(state);
    const [line, file] = TEXTS.map((name) => live.get(name)?.value || "");
    say(progress, old ? `Not known: ${old.why}` : inUnits(line));
    say(recording, file ? `Recording: ${file}` : "");
    say(hint, user.name || old ? (hasEnded ? begin : abort).why() : "To start a run, log in as an operator.");
    mark(element, "state", hasEnded ? "over" : "running");
  }

  return { element, update, end };
}
