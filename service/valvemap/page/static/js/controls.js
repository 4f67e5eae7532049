// Buttons that write: active only while what they rest on is of now, the user may, and there is something to do.

import { h } from "./dom.js";
import { live } from "./live.js";
import { told } from "./trust.js";
import { user } from "./user.js";

const controls = new Set();

/**
 * A button that carries out a command of the user. `of`: the valve, line or axis on whose values it rests; null: on the service alone.
 * `command()` is what it carries out; null while there is nothing to do, which `idle` explains. `does(command)` follows a click.
 * What is returned has the `button`, and `why()` it is not active, "" while it is. Until `does` has ended, another click does nothing.
 */
export function writer(label, { of = null, command, does, idle = "Nothing to do now.", look = "", type = "button" }) {
  const button = h(`button${look}`, { type, disabled: true, "data-writes": of ?? "service", onclick: type === "submit" ? null : () => control.act() }, label);
  let isBusy = false;
  const control = {
    button,
    why() {
      if (isBusy) return "This is being carried out …";
      const old = of === null ? live.old : live.oldOf(of), wanted = command();
      if (old) return `Nothing can be written: ${told(old)}`;
      if (!user.name) return "Log in as an operator of the service first.";
      return wanted ? user.mayNot(wanted) : idle;
    },
    update() {
      const why = control.why();
      if (button.disabled !== (why !== "")) button.disabled = why !== "";
      if (button.title !== why) button.title = why;
    },
    /** A click that comes before the service has told the right is not lost: the service refuses what it does not permit. */
    async act() {
      const why = control.why(), wanted = isBusy ? null : command();
      control.update();
      if (why && !(wanted && user.isAsking(wanted) && why === user.mayNot(wanted))) return;
      isBusy = true;
      control.update();
      try { await does(wanted); } finally { isBusy = false; }
      control.update();
    },
  };
  controls.add(control);
  queueMicrotask(control.update); // once the view is there that it is about
  return control;
}

/** Those of the view before. */
export const forgetControls = () => controls.clear();

const update = () => { for (const control of controls) control.update(); };
for (const what of ["standing", "trust", "values", "alarms"]) live.addEventListener(what, update);
for (const what of ["change", "rights"]) user.addEventListener(what, update);
live.addEventListener("standing", () => user.forgetRights());
