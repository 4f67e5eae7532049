// How the valve's sheet is made: rated flow, dead band, hysteresis and the others, each with a 95 % interval.

import { h, say } from "../dom.js";

/** The card, and its update. */
export function sheetCard({ live, valve }) {
  const words = h("p.words"), command = h("code.command");
  const element = h("section.card.sheet", {}, h("header", {}, h("h2", {}, "The valve's sheet")),
    h("p.words", {}, "Rated flow, dead band, flow gain, linearity, leakage, hysteresis and symmetry, each with a 95 % interval. It is made on the service's computer:"),
    command, words);

  function update() {
    const isDriven = live.has("Commission.State"), recording = live.get("Commission.Recording")?.value;
    element.hidden = Boolean(valve.family); // edges have none
    const name = /^[\w.-]+$/.test(valve.name) ? valve.name : `"${valve.name}"`;
    say(command, `valvemap sheet ${name} ${isDriven ? "--config valvemap.toml" : "--from sweep.csv"} --out ${name.replace(/"$|$/, (end) => `.html${end}`)}`);
    say(words, !isDriven ? "sweep.csv is a recording of triangles of U over the whole range, twice in each direction."
      : recording ? `It takes the recording of the last guided run: ${recording}.` : "It takes the recording of a guided run. There is none yet.");
  }

  return { element, update };
}
