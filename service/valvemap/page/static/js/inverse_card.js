// Which U for which flow or speed: the service is asked, and an operator may write the demand.

import { writer } from "./controls.js";
import { h, mark, say } from "./dom.js";
import { fixed, INVERSE_STATUS } from "./format.js";
import { inUnits } from "./units.js";

const ASK_MS = 150; // between two questions while a slider moves
const AGAIN_MS = 1000; // the map moves on

/**
 * `question(values)` is answered with {U, lower, upper, status} or {error}; `demand(values)` is the command that writes, `withdraw` (optional)
 * the one that ends it; `words(values)` says the demand; `inForce()` are the values of the demand in force, NaN without one.
 */
export function inverseCard({ live, ask, user, name, title, quantity, sliders, question, demand, withdraw = null, words, inForce, beside = [], verdicts = INVERSE_STATUS }) {
  const answer = h("span.value", { "aria-live": "off" }, "–"), interval = h("span.muted"), verdict = h("span.badge");
  const write = writer(`Write as ${quantity}`, { of: name, command: () => demand(values()), does: (command) => act(command, `Written: ${quantity} ${words(values())}.`) });
  const end = withdraw ? writer("Withdraw", { of: name, look: ".quiet", command: () => withdraw, does: (command) => act(command, `${quantity} is withdrawn.`) }) : null;
  const written = h("p.words", { role: "status" }), standing = h("p.words");
  const element = h("section.card.inverse", {}, h("header", {}, h("h2", {}, title)), sliders.map((one) => one.element), beside,
    h("div.answer", {}, h("span.muted", {}, "U ="), answer, interval, verdict), h("div.answer.writes", {}, write.button, end?.button), written, standing);
  let isAsking = false, timer = 0, outcome = ""; // of the last command

  const values = () => sliders.map((one) => one.value);

  function soon() {
    clearTimeout(timer);
    timer = setTimeout(update, ASK_MS);
  }

  function unknown(text) {
    say(answer, "–");
    say(interval, "");
    mark(verdict, "severity", 3);
    say(verdict, text);
    delete answer.dataset.for;
    delete answer.dataset.u;
  }

  async function update() {
    show();
    if (live.old) { unknown(`not known: ${live.old.why}`); return; }
    if (isAsking) { soon(); return; }
    isAsking = true;
    const wanted = values(), found = await ask("U", question(wanted)), old = live.oldOf(name);
    isAsking = false;
    if (!found) return;
    if (found.error) unknown(inUnits(found.error));
    else {
      const [severity, sentence] = verdicts[found.status] ?? [1, ""];
      say(answer, `${fixed(found.U ?? NaN, 2)} %`); // as finely as its interval
      say(interval, found.lower === null ? "" : `95 %: ${fixed(found.lower, 2)} to ${fixed(found.upper, 2)} %`);
      mark(verdict, "severity", old ? 3 : severity);
      say(verdict, old ? `not of now: ${old.why}` : sentence);
      mark(answer, "u", found.U ?? "");
      mark(answer, "for", wanted.join("@"));
    }
    if (wanted.some((value, k) => value !== sliders[k].value)) soon();
  }

  async function act(command, done) {
    const refused = await ask(command, user.command(command));
    if (refused === undefined) return;
    outcome = refused ?? done;
    show();
  }

  function show() {
    const why = write.why();
    say(written, !why ? outcome : user.name || live.oldOf(name) ? why : `Asking writes nothing. To write ${quantity}, log in as an operator.`);
    const demanded = inForce();
    say(standing, live.old ? "" : Number.isFinite(demanded[0]) ? `In force: ${quantity} ${words(demanded)}, RequiredU ${fixed(live.number("Inverse.RequiredU"), 1)} %.` : `No ${quantity} is in force.`);
  }

  for (const input of sliders.flatMap((one) => one.inputs)) input.addEventListener("input", soon);
  const again = setInterval(soon, AGAIN_MS);
  live.addEventListener("standing", update);
  live.addEventListener("values", show);
  for (const what of ["change", "rights"]) user.addEventListener(what, show);
  show();
  soon();
  return {
    element,
    close: () => {
      clearInterval(again);
      clearTimeout(timer);
      live.removeEventListener("standing", update);
      live.removeEventListener("values", show);
      for (const what of ["change", "rights"]) user.removeEventListener(what, show);
    },
  };
}
