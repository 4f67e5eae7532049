// The frame around the views: which is shown, of which valve, line or axis; theme, log-in, how the connection stands.

import { asker } from "./asking.js";
import { forgetControls } from "./controls.js";
import { h, mark, say } from "./dom.js";
import { familyTabs } from "./family.js";
import { clock, span } from "./format.js";
import { live } from "./live.js";
import { isFromAfar, readSpan } from "./spans.js";
import { tour } from "./tour.js";
import { choices, choose as chooseUnit } from "./units.js";
import { user } from "./user.js";
import { alarmsView } from "./views/alarms.js";
import { commissioningView } from "./views/commissioning.js";
import { mapView } from "./views/map.js";
import { overviewView } from "./views/overview.js";
import { partView } from "./views/part.js";
import { rigView } from "./views/rig.js";
import { timelineView } from "./views/timeline.js";
import { trendView } from "./views/trend.js";
import { valveView } from "./views/valve.js";

const VIEWS = [
  { key: "valve", digit: "1", title: "Valve", draw: valveView, of: "valve" },
  { key: "trend", digit: "t", title: "Trend", draw: trendView, of: "valve" },
  { key: "map", digit: "2", title: "Map", draw: mapView, of: "valve", withMap: true },
  { key: "alarms", digit: "a", title: "Alarms", draw: alarmsView },
  { key: "overview", digit: "3", title: "Overview", draw: overviewView },
  { key: "commissioning", digit: "4", title: "Commissioning", draw: commissioningView, of: "valve", withMap: true },
  { key: "axis", digit: "x", title: "Axis", draw: partView, of: "axis" },
  { key: "line", title: "Line", draw: partView, of: "line", isTab: true },
  { key: "timeline", digit: "5", title: "Time line", draw: timelineView },
  { key: "rig", digit: "6", title: "Rig", draw: rigView, of: "valve", onlyWithRig: true },
];

// Keys that lead to a field: of this view, or else of another one.
const FIELDS = { "/": ["overview", "input[type=search]"], q: ["map", ".inverse input[type=number]"] };

const root = document.querySelector("main"), nav = document.querySelector(".views"), strip = document.querySelector(".strip");
const link = document.querySelector(".link"), linkText = document.querySelector(".link-text");
let close = () => {}, shown = null, chosen = { trend: sessionStorage.getItem("trend") ?? "" }, wanted = "", wasOld = "";

const itemsOf = (of) => (of === "valve" ? live.valves.filter(({ kind }) => !kind) : [...live.valves, ...live.parts].filter(({ kind }) => kind === of));

const hasItems = () => live.valves.length > 0 || live.parts.length > 0;

/** The views of which there is something; those of valves while nothing is known yet, too. */
function views() {
  const isEmpty = !live.valves.length && !live.parts.length;
  return VIEWS.filter(({ onlyWithRig, of }) => (!onlyWithRig || user.hasRig) && (!of || itemsOf(of).length || (isEmpty && of === "valve")));
}

/** A part of a URL, which a person may have cut. */
function decoded(text) {
  try { return decodeURIComponent(text); } catch { return text; }
}

/** #/view/valve?what=is&seen=there */
function place() {
  const [path, query = ""] = location.hash.replace(/^#\//, "").split("?");
  const [key, name] = path.split("/").map(decoded);
  const view = views().find((known) => known.key === key) ?? views().find(({ of }) => of) ?? VIEWS[0];
  const items = itemsOf(view.of ?? "valve"), of = (wanted) => items.find((known) => known.name === wanted);
  const item = of(name) ?? of(chosen[view.of]) ?? of(chosen.valve) ?? items[0];
  return { view, item, query: new URLSearchParams(query) };
}

/** Keep in the URL what a view shows, so that a reload, a bookmark and a colleague see the same. */
function keep(view, item, query) {
  const path = `#/${view.key}${view.of && item ? `/${encodeURIComponent(item.name)}` : ""}`;
  const text = query.toString();
  history.replaceState(null, "", text ? `${path}?${text}` : path);
  if (view.key === "trend") { chosen.trend = text; sessionStorage.setItem("trend", text); drawNav(view); }
}

/** A view of the item that was last shown there. */
function hrefOf(view, item = itemsOf(view.of).find(({ name }) => name === chosen[view.of]) ?? itemsOf(view.of)[0]) {
  return `#/${view.key}${view.of && item ? `/${encodeURIComponent(item.name)}` : ""}${view.key === "trend" && chosen.trend ? `?${chosen.trend}` : ""}`;
}

function show() {
  const { view, item, query } = place();
  if (item && view.of) chosen[view.of] = item.name;
  drawNav(view);
  const key = `${view.key}/${item?.name}/${query}/${hasItems()}`;
  if (key === shown) return;
  shown = key;
  close();
  close = () => {};
  forgetControls();
  root.replaceChildren();
  root.dataset.view = view.key;
  mark(root, "stale", live.old !== null && hasItems());
  document.title = item && view.of ? `${item.name} · ${view.title} · valvemap` : `${view.title} · valvemap`;
  if (!hasItems()) {
    live.watch(null);
    root.append(nothing());
    return;
  }
  const ask = asker();
  const keepQuery = (kept) => { // an answer may come when the person has already gone on
    const here = place();
    if (!ask.isOpen() || here.view !== view || here.item?.name !== item?.name) return;
    keep(view, item, kept);
    shown = `${view.key}/${item?.name}/${place().query}/true`;
  };
  const common = { live, ask, user, query, keep: keepQuery };
  document.querySelector(".which").replaceChildren(...(view.of === "valve" && itemsOf("valve").length > 1 ? valvePicker(view, item) : []));
  const tabs = view.of && item ? familyTabs(live, view, item) : null;
  if (tabs) root.append(tabs);
  if (view.of !== "valve") live.watch(view.of ? item.name : null);
  const stop = view.of === "valve" ? showValve(view, item, common) : view.draw(root, { ...common, part: item });
  close = () => { ask.close(); stop?.(); };
  if (wanted) { root.querySelector(wanted)?.select(); wanted = ""; }
}

function showValve(view, valve, common) {
  const estimator = valve.estimators.includes(chosen.estimator) ? chosen.estimator : valve.primary;
  const choose = (name) => {
    chosen.estimator = name;
    if (view.withMap) live.watch(valve.name, name);
  };
  live.watch(valve.name, view.withMap ? estimator : null, view.key === "trend" && isFromAfar(readSpan(common.query).span));
  return view.draw(root, { ...common, valve, estimator, isChosen: chosen.estimator === estimator, choose });
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
  const list = h("datalist", { id: "valves" }, itemsOf("valve").map(({ name }) => h("option", { value: name })));
  const input = h("input", { list: "valves", value: valve.name, "aria-label": "Valve", title: "Which valve", size: 14, onfocus: () => input.select(), onchange: () => {
    const other = itemsOf("valve").find(({ name }) => name === input.value);
    if (other) location.hash = hrefOf(view, other);
    else input.value = valve.name;
  } });
  return [input, list];
}

function drawNav(view) {
  const unseen = live.alarms.filter(({ acked }) => !acked).length;
  nav.replaceChildren(...views().filter(({ isTab }) => !isTab).map((known) => h("a", {
    href: hrefOf(known), "aria-current": known === view ? "page" : null, title: `Key ${known.digit}`, "aria-keyshortcuts": known.digit,
  }, known.title, known.key === "alarms" && unseen ? h("span.bubble", { title: `${unseen} not acknowledged`, "aria-label": `${unseen} not acknowledged` }, String(unseen)) : null)));
}

function drawLink() {
  const old = live.old, state = old?.state ?? "up";
  mark(link, "link", state);
  say(linkText, { up: "Connected", lost: "Service lost", refused: "Refused", page: "Page server lost", connecting: "Connecting …" }[state]);
  strip.hidden = !old || state === "connecting" || !hasItems();
  if (!strip.hidden) {
    const since = old.since ? ` for ${span((Date.now() - old.since) / 1000)}, since ${clock(old.since)}` : "";
    strip.replaceChildren(`${old.why.replace(/\.$/, "")}${since}. What you see is old. ${old.advice}`, h("small", {}, state === "page" ? "" : live.text));
  }
  if (old && hasItems()) mark(root, "stale", true);
  else if (wasOld && !old) mark(root, "stale", false);
  if (wasOld !== (old?.state ?? "")) {
    wasOld = old?.state ?? "";
    live.dispatchEvent(new Event("standing"));
  }
  live.dispatchEvent(new Event("trust"));
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
    location.hash = hrefOf(view);
    root.focus();
  } else if (FIELDS[event.key]) {
    const [key, field] = FIELDS[event.key], other = views().find((known) => known.key === key), here = root.querySelector(field);
    if (!here && !other) return;
    event.preventDefault();
    if (here) here.select();
    else { wanted = field; location.hash = hrefOf(other); }
  }
});

addEventListener("hashchange", show);
live.addEventListener("layout", () => { shown = null; show(); });
live.addEventListener("link", () => { drawLink(); if (!hasItems()) { shown = null; show(); } });
user.addEventListener("change", show);
live.addEventListener("alarms", () => drawNav(place().view));
addEventListener("units", () => { shown = null; show(); });
document.addEventListener("click", (event) => {
  const units = document.querySelector(".units");
  if (units.open && !units.contains(event.target)) units.open = false;
});
tour(user, document.querySelector("aside.tour"), document.querySelector(".show-tour"));
drawUnits();
setInterval(drawLink, 500);
show();
