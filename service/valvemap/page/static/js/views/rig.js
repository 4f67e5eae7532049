// The virtual rig of a demo: scenarios to run, things to break.

import { writer } from "../controls.js";
import { h, say } from "../dom.js";
import { clock, KINDS } from "../format.js";
import { liveCard } from "../live_card.js";
import { fromShown, inUnits, shown, spreadShown, toShown } from "../units.js";

const MOST_REPORTS = 12;
const USUAL_S = 10;
const OF_FLOW = ["PredictedFlow", "Residual", "NoiseStd"];
const MINUTE_MS = 60000, STEP_MS = 100; // of history, with which the chart begins

const SCENARIOS = [
  ["demo", "what the demo begins with"], ["scattered", "U and Δp jump over the whole range"], ["structured", "U in steps, Δp swept at each"],
  ["cycle", "the working cycle of a machine"], ["ageing_valve", "a valve that wears, and is damaged"], ["verification", "points between the others"],
];
const FAULTS = [ // kind, sentence, unit, usual size, usual duration in s
  ["damage", "Damage: the main edge passes more or less, at once", "%", -10, 0], ["wear", "Wear: drifts there over the duration", "%", 10],
  ["temperature_ramp", "Oil temperature drifts", "K", 10], ["spikes", "Spikes on Q", "l/min", 30], ["offset", "Offset of Q", "l/min", 5],
  ["offset.p1", "Offset of p1", "bar", 5], ["frozen.p2", "p2 stands still", "", 1, 30], ["bad_quality", "Samples of Bad quality", "share", 1],
  ["drop_out", "Samples are not sent", "share", 0.5], ["clock_step", "The source's clock jumps", "s", 5],
];

export function rigView(root, { live, ask, valve, user }) {
  const scenario = h("select", { name: "scenario" }, SCENARIOS.map(([name, text]) => h("option", { value: name }, `${name}: ${text}`)));
  const kind = h("select", { name: "kind" }, FAULTS.map(([name, text]) => h("option", { value: name }, text)));
  const size = h("input", { name: "size", type: "number", step: "any", required: true }), unit = h("span.muted");
  const duration = h("input", { name: "duration", type: "number", min: 0, step: "any", required: true });
  const reports = h("ol.events"), done = h("p.words.rig-words", { role: "status" }), hint = h("p.muted");
  const start = writer("Start", { command: () => ({ scenario: scenario.value }), does: (command) => act(command, `Scenario ${scenario.value} runs.`) });
  const stop = writer("Stop", { look: ".quiet", command: () => ({ scenario: "" }), does: (command) => act(command, "The scenario is stopped.") });
  const inject = writer("Inject", { type: "submit", command: () => ({ fault: kind.value, valve: valve.name, size: fromShown(Number(size.value), unitOf()), duration: Number(duration.value) }), does: (command) => act(command, `Injected: ${kind.selectedOptions[0].text.split(":")[0]}, ${size.value} ${shown(unitOf())} ${Number(duration.value) ? `for ${duration.value} s` : "for good"}. What the service reports appears below within seconds.`) });

  const best = () => live.get("Recommended")?.value || valve.primary;
  const banded = (predicted, missed, noise) => [predicted + 1.96 * noise, predicted - 1.96 * noise, predicted, predicted + missed].map((value) => toShown(value, "l/min"));

  function newest() {
    const entry = live.get(`${best()}.PredictedFlow`);
    return [(entry?.t ?? 0) / 1000, banded(...OF_FLOW.map((name) => live.number(`${best()}.${name}`)))];
  }

  async function lastMinute() {
    const now = Date.now(), found = await ask("minute", live.trend(valve.name, OF_FLOW.map((name) => `${best()}.${name}`), now - MINUTE_MS, now, STEP_MS));
    if (!found || found.error) return found && [];
    const [predicted, missed, noise] = found.courses.map(([mean]) => [...mean]);
    return predicted.map((value, k) => [(found.start + (k + 0.5) * found.step) / 1000, banded(value, missed[k], noise[k])]).filter(([, values]) => Number.isFinite(values[2]));
  }

  const course = liveCard(live, {
    title: `Flow of ${valve.name}, measured and predicted`, unit: `Q in ${shown("l/min")}`, bands: [[1, 2, "--line-1"]], row: newest, past: lastMinute,
    legend: [["measured", "--measured"], ["predicted, 95 % of measurements", "--line-1"]],
    series: [{ label: "upper", colour: "--line-1", width: 0 }, { label: "lower", colour: "--line-1", width: 0 }, { label: "predicted", colour: "--line-1" }, { label: "measured", colour: "--measured", dots: true }],
  });

  root.append(
    h("div.head", {}, h("h1", {}, "Virtual rig"), hint),
    h("div.filled", {}, h("div.grid.two", {},
      h("section.card", {}, h("header", {}, h("h2", {}, "Scenario")), h("div.form", {}, h("label", {}, "What the rig plays", scenario), h("div.buttons", {}, stop.button, start.button))),
      h("section.card", {}, h("header", {}, h("h2", {}, `Break something of ${valve.name}`)),
        h("form.form", { onsubmit: (event) => {
          event.preventDefault();
          inject.act();
        } }, h("label", {}, "What goes wrong", kind), h("div.pair", {}, h("label", {}, h("span", {}, "Size ", unit), size), h("label", {}, "Duration in s (0 = for good)", duration)), h("div.buttons", {}, inject.button)), done),
    ),
    h("section.card.reports", {}, h("header", {}, h("h2", {}, `What the service reports of ${valve.name}`), h("span.fill"), h("a", { href: "#/alarms" }, "All alarms")), reports), course.element),
  );

  function showReports() {
    const found = live.events.filter((event) => event.valve === valve.name).sort((a, b) => b.t - a.t || b.number - a.number).slice(0, MOST_REPORTS);
    reports.replaceChildren(...found.map((event) => h("li", {}, h("time.muted", {}, clock(event.t)), h("span", {}, h("span.badge", { "data-severity": event.severity }, KINDS[event.kind] ?? event.kind)), h("span", {}, inUnits(event.text)))));
    if (!found.length) reports.append(h("li.muted", {}, "Nothing yet."));
  }

  const unitOf = () => FAULTS.find(([name]) => name === kind.value)[2];

  function choose() {
    const [, , of, usual, seconds = USUAL_S] = FAULTS.find(([name]) => name === kind.value);
    say(unit, of ? `in ${shown(of)}` : "(not used)");
    size.value = Number(spreadShown(usual, of).toPrecision(3));
    duration.value = seconds;
  }

  async function act(command, text) {
    say(done, "…");
    const refused = await ask(command, user.command(command));
    if (refused !== undefined) say(done, refused ?? text);
  }

  function showUser() {
    say(hint, live.old || user.name ? start.why() || `As ${user.name}.` : "Log in as operator (the demo has printed the password) to play with it.");
  }

  kind.addEventListener("change", choose);
  for (const what of ["change", "rights"]) user.addEventListener(what, showUser);
  choose();
  showUser();
  showReports();
  live.addEventListener("standing", showUser);
  live.addEventListener("events", showReports);
  return () => { course.close(); live.removeEventListener("events", showReports); for (const what of ["change", "rights"]) user.removeEventListener(what, showUser); live.removeEventListener("standing", showUser); };
}
