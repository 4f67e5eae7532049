// The frame around the views: which is shown, of which valve; theme, log-in, how the connection stands.

import { h, mark, say } from "./dom.js";
import { span } from "./format.js";
import { Live } from "./live.js";
import { user } from "./user.js";
import { commissioningView } from "./views/commissioning.js";
import { mapView } from "./views/map.js";
import { overviewView } from "./views/overview.js";
import { rigView } from "./views/rig.js";
import { timelineView } from "./views/timeline.js";
import { valveView } from "./views/valve.js";

const VIEWS = [
  { key: "valve", title: "Valve", draw: valveView, ofValve: true },
  { key: "map", title: "Map", draw: mapView, ofValve: true, withMap: true },
  { key: "overview", title: "Overview", draw: overviewView },
  { key: "commissioning", title: "Commissioning", draw: commissioningView, ofValve: true, withMap: true },
  { key: "timeline", title: "Time line", draw: timelineView },
  { key: "rig", title: "Rig", draw: rigView, ofValve: true, onlyWithRig: true },
];
const SILENT_MS = 4000; // the page hears something every second

const live = new Live();
const root = document.querySelector("main"), nav = document.querySelector(".views"), strip = document.querySelector(".strip");
const link = document.querySelector(".link"), linkText = document.querySelector(".link-text");
let close = () => {}, shown = null, chosen = {}, searching = false;

function views() { return VIEWS.filter((view) => !view.onlyWithRig || user.hasRig); }

/** #/view/valve */
function place() {
  const [key, name] = location.hash.replace(/^#\//, "").split("/").map(decodeURIComponent);
  const view = views().find((known) => known.key === key) ?? VIEWS[0];
  const valve = live.valves.find((known) => known.name === name) ?? live.valves.find((known) => known.name === chosen.valve) ?? live.valves[0];
  return { view, valve };
}

function show() {
  const { view, valve } = place();
  drawNav(view, valve);
  const key = `${view.key}/${valve?.name}/${live.valves.length > 0}`;
  if (key === shown) return;
  shown = key;
  close();
  close = () => {};
  root.replaceChildren();
  delete root.dataset.stale;
  document.title = valve && view.ofValve ? `${valve.name} · ${view.title} · valvemap` : `${view.title} · valvemap`;
  if (!live.valves.length) {
    live.watch(null);
    root.append(nothing());
    return;
  }
  if (valve) chosen.valve = valve.name;
  const estimator = valve.estimators.includes(chosen.estimator) ? chosen.estimator : valve.primary;
  const choose = (name) => {
    chosen.estimator = name;
    if (view.withMap) live.watch(valve.name, name);
  };
  live.watch(view.ofValve ? valve.name : null, view.withMap ? estimator : null);
  if (view.ofValve && live.valves.length > 1) root.append(valvePicker(view, valve));
  close = view.draw(root, { live, valve, estimator, choose, user }) ?? (() => {});
  if (searching) { searching = false; root.querySelector("input[type=search]")?.focus(); }
}

function nothing() {
  const words = {
    connecting: ["Connecting …", "The page is looking for the service."],
    lost: ["The service does not answer", live.text],
    refused: ["The service refuses this page", live.text],
    page: ["This page's server does not answer", "It may have been stopped. The page tries again by itself."],
    up: ["No valves yet", "The service runs, but identifies no valve. Name one in its configuration: valvemap connect."],
  }[live.link];
  return h("div.empty", {}, h("h1", {}, words[0]), h("p", {}, words[1]));
}

function valvePicker(view, valve) {
  const list = h("datalist", { id: "valves" }, live.valves.map(({ name }) => h("option", { value: name })));
  const input = h("input", { list: "valves", value: valve.name, "aria-label": "Valve", onchange: () => {
    if (live.valves.some(({ name }) => name === input.value)) location.hash = `#/${view.key}/${encodeURIComponent(input.value)}`;
    else input.value = valve.name;
  } });
  return h("div.head", {}, h("label", {}, "Valve ", input), list);
}

function drawNav(view, valve) {
  nav.replaceChildren(...views().map((known, k) => h("a", {
    href: `#/${known.key}${known.ofValve && valve ? `/${encodeURIComponent(valve.name)}` : ""}`,
    "aria-current": known === view ? "page" : null, title: `Key ${k + 1}`,
  }, known.title)));
}

function drawLink() {
  const silent = performance.now() - live.heardAt > SILENT_MS;
  const state = live.link === "up" && silent ? "page" : live.link;
  mark(link, "link", state);
  say(linkText, { up: "Live", lost: "Service lost", refused: "Refused", page: "Page server lost", connecting: "Connecting …" }[state]);
  strip.hidden = state === "up" || state === "connecting" || !live.valves.length;
  if (!strip.hidden) {
    const since = live.since && state !== "page" ? ` for ${span((Date.now() - live.since) / 1000)}` : "";
    strip.replaceChildren(`${{ lost: "The service does not answer", refused: "The service refuses this page", page: "This page's server does not answer" }[state]}${since}. What you see is old.`,
      h("small", {}, state === "page" ? "" : live.text));
    mark(root, "stale", true);
  } else if (state === "up" && root.dataset.stale === "true") mark(root, "stale", false);
}

document.querySelector(".theme").addEventListener("click", () => {
  const next = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  document.documentElement.dataset.theme = next;
  localStorage.setItem("theme", next);
  dispatchEvent(new Event("theme"));
});

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target.matches?.("input:not([type=range]), select, textarea") || document.querySelector("dialog[open]")) return;
  const view = views()[Number(event.key) - 1];
  if (view) {
    location.hash = `#/${view.key}${view.ofValve && place().valve ? `/${encodeURIComponent(place().valve.name)}` : ""}`;
    root.focus();
  } else if (event.key === "/") {
    event.preventDefault();
    if (place().view.key === "overview") root.querySelector("input[type=search]")?.focus();
    else { searching = true; location.hash = "#/overview"; }
  }
});

addEventListener("hashchange", show);
live.addEventListener("layout", () => { shown = null; show(); });
live.addEventListener("link", () => { drawLink(); if (!live.valves.length) { shown = null; show(); } });
user.addEventListener("change", show);
setInterval(drawLink, 500);
show();
