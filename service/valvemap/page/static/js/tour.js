// Three steps through a demo: watch it learn, break the valve, read what it reports.

import { h } from "./dom.js";

const STEPS = [
  { title: "Watch it learn", view: "map", seen: /^#\/map/,
    text: "The service has never seen this valve. It learns the flow over U and Δp from the samples as they come: watch the surface settle, and “Extrapolated” shrink." },
  { title: "Break the valve", view: "rig", seen: /^#\/rig/,
    text: "Log in as operator (the demo has printed the password), choose “Damage” and press Inject. Give the map half a minute before: until then, the service cannot tell a change from learning. The rig's main edge now passes less oil than before." },
  { title: "Read what it reports", view: "alarms", seen: /^#\/(alarms|trend|map)/, // its links lead there
    text: "Within seconds an alarm says what was measured, what it may be, and what to do. From there, “Trend at that time” and “Place in the map” show it." },
];

/** Offer the tour where there is a rig to break; once closed it stays closed, and a button brings it back. */
export function tour(user, panel, again) {
  let step = Number(sessionStorage.getItem("tour") ?? 0);

  function close() { localStorage.setItem("tour", "closed"); draw(); }

  function go(to) {
    step = Math.min(Math.max(to, 0), STEPS.length - 1);
    sessionStorage.setItem("tour", step);
    location.hash = `#/${STEPS[step].view}`;
    draw();
  }

  function draw() {
    const isClosed = localStorage.getItem("tour") === "closed";
    panel.hidden = !user.hasRig || isClosed;
    again.hidden = !user.hasRig || !isClosed;
    if (panel.hidden) return;
    const { title, text, seen } = STEPS[step], isThere = seen.test(location.hash);
    panel.replaceChildren(
      h("p.step", {}, `Tour, step ${step + 1} of ${STEPS.length}`), h("h2", {}, title), h("p.words", {}, text),
      h("div.buttons", {}, h("button.quiet", { type: "button", onclick: close }, "Close"),
        step ? h("button.quiet", { type: "button", onclick: () => go(step - 1) }, "Back") : null,
        !isThere ? h("button", { type: "button", onclick: () => go(step) }, "Show me")
          : step < STEPS.length - 1 ? h("button", { type: "button", onclick: () => go(step + 1) }, "Next") : h("button", { type: "button", onclick: close }, "Done")),
    );
  }

  again.addEventListener("click", () => { localStorage.removeItem("tour"); go(0); });
  user.addEventListener("change", draw);
  addEventListener("hashchange", draw);
  draw();
}
