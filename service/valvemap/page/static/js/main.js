// The frame around the views: which is shown, of which valve; theme, log-in, how the connection stands.

import { h, mark, say } from "./dom.js";
import { clock, span } from "./format.js";
import { Live } from "./live.js";
import { tour } from "./tour.js";
import { choices, choose as chooseUnit } from "./units.js";
import { user } from "./user.js";
import { alarmsView } from "./views/alarms.js";
import { commissioningView } from "./views/commissioning.js";
import { mapView } from "./views/map.js";
import { overviewView } from "./views/overview.js";
import { rigView } from "./views/rig.js";
import { timelineView } from "./views/timeline.js";
import { trendView } from "./views/trend.js";
import { valveView } from "./views/valve.js";

const VIEWS = [
  { key: "valve", digit: "1", title: "Valve", draw: valveView, ofValve: true },
  { key: "trend", digit: "t", title: "Trend", draw: trendView, ofValve: true },
  { key: "map", digit: "2", title: "Map", draw: mapView, ofValve: true, withMap: true },
  { key: "alarms", digit: "a", title: "Alarms", draw: alarmsView },
  { key: "overview", digit: "3", title: "Overview", draw: overviewView },
  { key: "commissioning", digit: "4", title: "Commissioning", draw: commissioningView, ofValve: true, withMap: true },
  { key: "timeline", digit: "5", title: "Time line", draw: timelineView },
  { key: "rig", digit: "6", title: "Rig", draw: rigView, ofValve: true, onlyWithRig: true },
];

const live = new Live();
const root = document.querySelector("main"), nav = document.querySelector(".views"), strip = document.querySelector(".strip");
const link = document.querySelector(".link"), linkText = document.querySelector(".link-text");
let close = () => {}, shown = null, chosen = { trend: sessionStorage.getItem("trend") ?? "" }, searching = false, wasOld = "";

function views() { return VIEWS.filter((view) => !view.onlyWithRig || user.hasRig); }

/** #/view/valve?what=is&seen=there */
function place() {
  const [path, query = ""] = location.hash.replace(/^#\//, "").split("?");
  const [key, name] = path.split("/").map(decodeURIComponent);
  const view = views().find((known) => known.key === key) ?? VIEWS[0];
  const valve = live.valves.find((known) => known.name === name) ?? live.valves.find((known) => known.name === chosen.valve) ?? live.valves[0];
  return { view, valve, query: new URLSearchParams(query) };
}

/** Keep in the URL what a view shows, so that a reload, a bookmark and a colleague see the same. */
function keep(view, valve, query) {
  const path = `#/${view.key}${view.ofValve && valve ? `/${encodeURIComponent(valve.name)}` : ""}`;
  const text = query.toString();
  history.replaceState(null, "", text ? `${path}?${text}` : path);
  if (view.key === "trend") { chosen.trend = text; sessionStorage.setItem("trend", text); drawNav(view, valve); }
}

const hrefOf = (view, valve) => `#/${view.key}${view.ofValve && valve ? `/${encodeURIComponent(valve.name)}` : ""}${view.key === "trend" && chosen.trend ? `?${chosen.trend}` : ""}`;

function show() {
  const { view, valve, query } = place();
  drawNav(view, valve);
  const key = `${view.key}/${valve?.name}/${query}/${live.valves.length > 0}`;
  if (key === shown) return;
  shown = key;
  close();
  close = () => {};
  root.replaceChildren();
  root.dataset.view = view.key;
  mark(root, "stale", live.old !== null && live.valves.length > 0);
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
  document.querySelector(".which").replaceChildren(...(view.ofValve && live.valves.length > 1 ? valvePicker(view, valve) : []));
  const keepQuery = (kept) => { keep(view, valve, kept); shown = `${view.key}/${valve?.name}/${place().query}/true`; };
  const isChosen = chosen.estimator === estimator;
  close = view.draw(root, { live, valve, estimator, isChosen, choose, user, query, keep: keepQuery }) ?? (() => {});
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
  const input = h("input", { list: "valves", value: valve.name, "aria-label": "Valve", title: "Which valve", size: 14, onfocus: () => input.select(), onchange: () => {
    const other = live.valves.find(({ name }) => name === input.value);
    if (other) location.hash = hrefOf(view, other);
    else input.value = valve.name;
  } });
  return [input, list];
}

function drawNav(view, valve) {
  const unseen = live.alarms.filter(({ acked }) => !acked).length;
  nav.replaceChildren(...views().map((known) => h("a", {
    href: hrefOf(known, valve), "aria-current": known === view ? "page" : null, title: `Key ${known.digit}`, "aria-keyshortcuts": known.digit,
  }, known.title, known.key === "alarms" && unseen ? h("span.bubble", { "aria-label": `${unseen} not acknowledged` }, String(unseen)) : null)));
}

function drawLink() {
  const old = live.old, state = old?.state ?? "up";
  mark(link, "link", state);
  say(linkText, { up: "Live", lost: "Service lost", refused: "Refused", page: "Page server lost", connecting: "Connecting …" }[state]);
  strip.hidden = !old || state === "connecting" || !live.valves.length;
  if (!strip.hidden) {
    const since = old.since ? ` for ${span((Date.now() - old.since) / 1000)}, since ${clock(old.since)}` : "";
    strip.replaceChildren(`${old.why.replace(/\.$/, "")}${since}. What you see is old. ${old.advice}`, h("small", {}, state === "page" ? "" : live.text));
  }
  if (old && live.valves.length) mark(root, "stale", true);
  else if (wasOld && !old) mark(root, "stale", false);
  if (wasOld !== (old?.state ?? "")) {
    wasOld = old?.state ?? "";
    live.dispatchEvent(new Event("standing"));
  }
}

function drawUnits() {
  const menu = document.querySelector(".units .menu");
  menu.replaceChildren(...choices().map(([kind, used, units]) => h("label", {}, `${kind[0].toUpperCase()}${kind.slice(1)}`,
    h("select", { name: kind, onchange: (event) => chooseUnit(kind, event.target.value) }, units.map((unit) => h("option", { value: unit, selected: unit === used }, unit))))));
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
  const view = views().find(({ digit }) => digit === event.key);
  if (view) {
    location.hash = hrefOf(view, place().valve);
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
live.addEventListener("alarms", () => { const { view, valve } = place(); drawNav(view, valve); });
addEventListener("units", () => { shown = null; show(); });
document.addEventListener("click", (event) => {
  const units = document.querySelector(".units");
  if (units.open && !units.contains(event.target)) units.open = false;
});
tour(user, document.querySelector("aside.tour"), document.querySelector(".show-tour"));
drawUnits();
setInterval(drawLink, 500);
show();
