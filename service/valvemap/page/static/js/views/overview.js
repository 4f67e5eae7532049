// All valves, worst first: health, why, since when, what it did lately; and the alarms that wait for an operator.

import { css, h, mark, pen, say } from "../dom.js";
import { clock, count, counted, HEALTH, inUnit, NAN, REASONS, span, spaced, spreadInUnit } from "../format.js";
import { parts } from "../intervals.js";
import { standingOf } from "../trust.js";
import { inUnits, shown } from "../units.js";

const byName = new Intl.Collator("en", { numeric: true }).compare;
const LOWEST = 34, HIGHEST = 80; // px of a row
const HEAD = 34; // px of the table's head and its edges
const MARGIN = 4; // rows drawn above and below what is seen
const WORST_HEALTH = [1, 3, 4, 2, 0]; // by NAMUR NE 107: failure, out of specification, maintenance, function check, normal
const HEALTH_SEVERITY = [0, 3, 1, 2, 2]; // of normal, failure, function check, out of specification, maintenance
const SECONDS = 120; // of a row's little chart
const MOST_ALARMS = 12;

export function overviewView(root, { live }) {
  const columns = () => [
    ["severity", "State", "168px", ""], ["name", "Valve", "15%", ""], ["health", "Health (NE 107)", "196px", ""], ["why", "Why", "", ""],
    ["since", "Since", "104px", ""], ["rmse", `RMSE, ${shown("l/min")}`, "108px", ".number"],
    ["predicted", `Q̂, ${shown("l/min")}`, "92px", ".number"], ["course", "Last 2 min", "120px", ""], ["samples", "Samples", "104px", ".number"],
  ];
  const COLUMNS = columns();
  const search = h("input.overview-search", { type: "search", placeholder: "Search valves and reasons  ( / )", "aria-label": "Search", size: 30 });
  const grouping = h("select", { "aria-label": "Group by", onchange: () => { localStorage.setItem("grouping", grouping.value); sort(); } },
    [["", "no groups"], ["health", "by health"], ["part", "by part of the plant"]].map(([value, text]) => h("option", { value, selected: value === (localStorage.getItem("grouping") ?? "") }, text)));
  const counts = h("span.counts"), table = h("tbody"), body = h("div.rows.card", { tabindex: 0, role: "region", "aria-label": "Valves" });
  const top = h("tr", { "aria-hidden": "true" }, h("td", { colspan: COLUMNS.length })), bottom = top.cloneNode(true);
  const needs = h("ul.needs"), needsNote = h("p.words"), service = h("p.service");
  let order = { by: "severity", down: true }, items = [], drawn = [], seen = 0, height = LOWEST;

  const heads = COLUMNS.map(([key, title, width, kind]) => h(`th${kind}`, { style: width ? { width } : {}, scope: "col", "data-column": key },
    key === "course" ? title : h("button", { type: "button", onclick: () => { order = { by: key, down: order.by === key ? !order.down : key !== "name" }; sort(); } }, title)));
  body.append(h("table", {}, h("thead", {}, h("tr", {}, heads)), table));
  table.append(top, bottom);
  root.append(h("div.head", {}, h("h1", {}, "All valves"), counts, h("span.fill"), h("label", {}, "Group ", grouping), search),
    h("div.overview-grid", {}, body, h("aside.card.needs-card", { "aria-label": "Waiting for an operator" }, h("header", {}, h("h2", {}, "Waiting for an operator"), h("span.fill"), h("a", { href: "#/alarms" }, "All alarms")), service, needs, needsNote)));

  const groupOf = {
    "": () => "", health: (row) => HEALTH[row.health]?.[0] ?? "health not known",
    part: (row) => row.name.match(/^(.+?)[._/: -]+[^._/: -]*\d*$/)?.[1] ?? "others",
  };

  function sort() {
    const old = live.old, words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    const rows = live.valves.map(({ name }, number) => ({ name, number, ...live.rows.get(number) })).filter((row) => row.severity !== undefined)
      .filter((row) => !words.length || words.every((word) => `${row.name} ${REASONS[row.reason].slice(0, 2).join(" ")} ${HEALTH[row.health]?.[0] ?? ""}`.toLowerCase().includes(word)));
    const worst = (row) => 1000 * row.severity + 10 * (5 - WORST_HEALTH.indexOf(row.health)) + row.reason / 10;
    const key = { severity: worst, why: (r) => r.reason, name: (r) => r.name, health: (r) => 5 - WORST_HEALTH.indexOf(r.health) }[order.by] ?? ((r) => r[order.by]);
    const sign = order.down ? -1 : 1;
    rows.sort((a, b) => {
      const [x, y] = [key(a), key(b)];
      if (typeof x === "string") return sign * byName(x, y);
      return sign * ((x || 0) - (y || 0)) || a.since - b.since || a.number - b.number;
    });
    items = grouped(rows);
    heads.forEach((head, k) => {
      if (COLUMNS[k][0] === order.by) head.setAttribute("aria-sort", order.down ? "descending" : "ascending");
      else head.removeAttribute("aria-sort");
    });
    const of = [0, 0, 0, 0];
    for (const row of rows) of[standingOf(live, row.name).severity] += 1;
    const words_ = [null, "note", "warning", "alarm"];
    height = Math.min(Math.max(Math.floor((seen - HEAD) / Math.max(items.length, 1)), LOWEST), HIGHEST);
    body.style.setProperty("--row", `${height}px`);
    counts.replaceChildren(...(old ? [h("span.badge", { "data-severity": 3 }, `not known since ${clock(old.since)}`)]
      : [3, 2, 1, 0].filter((k) => of[k]).map((k) => h("span.badge", { "data-severity": k }, k ? counted(of[k], words_[k]) : `${of[k]} good`))));
    draw();
    drawNeeds();
  }

  /** Rows below the name of their group; the group with the worst valve first. */
  function grouped(rows) {
    if (!grouping.value) return rows;
    const groups = new Map();
    for (const row of rows) {
      const name = groupOf[grouping.value](row);
      groups.set(name, [...(groups.get(name) ?? []), row]);
    }
    const worst = (some) => Math.max(...some.map((row) => row.severity));
    return [...groups].sort((a, b) => worst(b[1]) - worst(a[1]) || byName(a[0], b[0])).flatMap(([name, some]) => [{ group: name, some }, ...some]);
  }

  /** Only the rows that are seen exist. */
  function draw() {
    const first = Math.max(Math.floor(body.scrollTop / height) - MARGIN, 0);
    const last = Math.min(first + Math.ceil(seen / height) + 2 * MARGIN, items.length);
    top.firstChild.style.height = `${first * height}px`;
    bottom.firstChild.style.height = `${(items.length - last) * height}px`;
    top.hidden = first === 0;
    bottom.hidden = last === items.length;
    while (drawn.length > last - first) drawn.pop().remove();
    while (drawn.length < last - first) {
      const row = h("tr", {}, h("td", {}, h("span.badge")), h("td", {}, h("a")), h("td", {}, h("span.health")), h("td"), h("td"), h("td.number"), h("td.number"), h("td", {}, h("canvas.course", { "aria-hidden": "true" })), h("td.number"));
      drawn.push(row);
      bottom.before(row);
    }
    drawn.forEach((element, k) => fill(element, items[first + k]));
  }

  function fill(element, row) {
    const [state, name, health, why, since, rmse, predicted, course, samples] = element.cells;
    element.classList.toggle("group", Boolean(row.group));
    for (const cell of [state, health, since, rmse, predicted, course, samples]) cell.firstChild?.toggleAttribute?.("hidden", Boolean(row.group));
    if (row.group) {
      name.firstChild.removeAttribute("href");
      say(name.firstChild, row.group);
      const bad = row.some.filter((one) => one.severity > 0).length;
      say(why, `${counted(row.some.length, "valve")}${bad ? `, ${bad} not good` : ""}`);
      for (const cell of [since, rmse, predicted, samples]) say(cell, "");
      mark(element, "stale", false);
      return;
    }
    const { old, severity, label, sentence, since: begun } = standingOf(live, row.name);
    mark(element, "stale", old !== null);
    mark(state.firstChild, "severity", live.old ? 1 : severity);
    say(state.firstChild, label);
    const href = live.hrefOf(row.name);
    if (name.firstChild.getAttribute("href") !== href) name.firstChild.setAttribute("href", href);
    say(name.firstChild, row.name);
    mark(health.firstChild, "severity", old ? 1 : HEALTH_SEVERITY[row.health] ?? 1);
    say(health.firstChild, old ? "not known" : HEALTH[row.health]?.[0] ?? NAN);
    say(why, live.old ? `${old.why} Before: ${REASONS[row.reason][0] === "ok" ? "no finding" : REASONS[row.reason][0]}.` : old ? old.why : sentence);
    say(since, clock(begun));
    say(rmse, spreadInUnit(row.rmse, "l/min", 2));
    say(predicted, inUnit(row.predicted, "l/min", 1));
    say(samples, count(row.samples));
    drawCourse(course.firstChild, live.courses.get(row.number), severity);
  }

  function drawCourse(canvas, course, severity) {
    const { context, width, height: high } = pen(canvas);
    if (!course || course.length < 2 || !width) return;
    const values = course.map(([, value]) => value).filter(Number.isFinite), low = Math.min(...values), top_ = Math.max(...values), end = course.at(-1)[0];
    context.strokeStyle = css(severity > 1 ? ["", "", "--warning", "--alarm"][severity] : "--line-6");
    context.lineWidth = 1.25;
    context.beginPath();
    for (const [t, value] of course) {
      if (!Number.isFinite(value)) continue;
      context.lineTo(width * (1 - (end - t) / SECONDS / 1000), high - 2 - (high - 4) * ((value - low) / (top_ - low || 1)));
    }
    context.stroke();
  }

  function drawNeeds() {
    const old = live.old, some = live.alarms.slice(0, MOST_ALARMS);
    const key = JSON.stringify([some, old?.state, live.alarmTrouble, Math.floor(Date.now() / 10000)]);
    if (needs.dataset.key === key) return;
    needs.dataset.key = key;
    needs.replaceChildren(...some.map((alarm) => h("li", {}, h("a", { href: `#/alarms?show=${alarm.active ? "active" : "unacked"}&alarm=${encodeURIComponent(`${alarm.source}/${alarm.name}`)}` },
      h("span.badge", { "data-severity": alarm.active ? alarm.severity : 1 }, alarm.active ? "active" : alarm.acked ? "to confirm" : "ended, not seen"),
      h("strong", {}, alarm.source), h("time.muted", {}, span((Date.now() - alarm.since) / 1000)), h("span.first", {}, `${spaced(alarm.name)}: ${inUnits(parts(alarm.text).measured)}`)))));
    const ofService = live.alarms.filter(({ source, active }) => source === "Service" && active).length;
    say(service, old || live.alarmTrouble ? "" : ofService ? `The service itself: ${counted(ofService, "active alarm")}.` : "The service itself has no active alarm.");
    say(needsNote, old ? `${old.why} ${old.advice}` : live.alarmTrouble ? `Alarms are not known: ${live.alarmTrouble}` : some.length ? (live.alarmCount > some.length ? `${live.alarmCount - some.length} more.` : "") : "Nothing: no alarm is active, and all are acknowledged.");
  }

  /** Once before the next frame, however often it is asked for. */
  function soon(what) {
    let due = 0;
    return () => { due ||= requestAnimationFrame(() => { due = 0; what(); }); };
  }

  const sortSoon = soon(sort);
  search.addEventListener("input", sortSoon);
  search.addEventListener("keydown", (event) => {
    if (event.key !== "Enter") return;
    sort();
    const first = items.find(({ group }) => !group);
    if (first) location.hash = live.hrefOf(first.name);
  });
  body.addEventListener("scroll", soon(draw), { passive: true });
  const resize = new ResizeObserver(() => { seen = body.clientHeight; sort(); });
  resize.observe(body);
  for (const what of ["rows", "alarms", "standing"]) live.addEventListener(what, sortSoon);
  seen = body.clientHeight;
  sort();
  return () => { for (const what of ["rows", "alarms", "standing"]) live.removeEventListener(what, sortSoon); resize.disconnect(); };
}
