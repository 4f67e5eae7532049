// Alarms: what was measured, what it may be, what to do; from there to the trend and the map.

import { writer } from "../controls.js";
import { h, mark, say } from "../dom.js";
import { clock, counted, GUIDES, span, spaced } from "../format.js";
import { activeSpans, endedSpans, merged, parts } from "../intervals.js";
import { inUnits } from "../units.js";
import { alarmTrend } from "./alarm_trend.js";

const TABS = [["active", "Active"], ["unacked", "Not acknowledged"], ["past", "Past"]];
const PAST_MS = 30 * 86400e3;
const AROUND_S = 600; // of a trend, around the time of an alarm
const keyOf = ({ source, name }) => `${source}/${name}`;

export function alarmsView(root, { live, ask, query, keep, user }) {
  let picked = TABS.some(([key]) => key === query.get("show")) ? query.get("show") : null, tab = null, chosen = query.get("alarm") ?? "", at = Number(query.get("t")) || 0;
  let past = [], kept = true, why = "", shown = [], askOfChosen = ask.within();

  const tabs = h("span.segments", { role: "group", "aria-label": "Which alarms" }, TABS.map(([key]) => h("button", { type: "button", "data-tab": key, onclick: () => { picked = key; chosen = ""; at = 0; update(); } })));
  const search = h("input", { type: "search", placeholder: "Search alarms", "aria-label": "Search alarms", size: 22 });
  const list = h("ul.alarm-list", { "aria-label": "Alarms" }), note = h("p.words"), detail = h("section.card.alarm-detail", { "aria-live": "off" });
  root.append(h("div.head", {}, h("h1", {}, "Alarms"), tabs, h("span.fill"), search), h("div.alarm-grid", {}, h("section.card.alarm-side", {}, list, note), detail));

  const comment = h("input", { name: "comment", maxlength: 200, autocomplete: "off" }), done = h("p.words", { role: "status" }), hint = h("p.words"), around = alarmTrend(live);
  const STEPS = { Acknowledge: ({ acked }) => !acked, Confirm: ({ acked, confirmed }) => acked && !confirmed, Comment: () => true };
  const present = () => live.alarms.find((one) => keyOf(one) === detail.dataset.alarm?.split("@")[0]);
  const steps = Object.fromEntries(Object.entries(STEPS).map(([name, isDue]) => [name, writer(name, {
    look: name === "Comment" ? ".quiet" : "", idle: "This alarm does not wait for it.", does: (command) => act(name, command),
    command: () => {
      const now = present();
      return now && isDue(now) ? { alarm: now.name, of: now.source, do: name, comment: comment.value, ...(name === "Comment" ? { event: now.event } : {}) } : null;
    },
  })]));

  function rows() {
    if (tab === "past") {
      return endedSpans(activeSpans(merged(past, live.alarms)), live.alarms, live.hasAllAlarms).map((one) => {
        const newest = merged(past, live.alarms).filter((c) => keyOf(c) === keyOf(one) && c.t >= one.from).sort((a, b) => b.t - a.t)[0] ?? one.raised;
        return { ...one.raised, ...(one.to === null ? newest : {}), severity: one.severity, t: one.from, until: one.to, text: one.text || one.raised.text, user: newest.user, comment: newest.comment, active: one.to === null };
      }).filter(({ t }) => t > 0).sort((a, b) => b.t - a.t);
    }
    return live.alarms.filter((alarm) => (tab === "active" ? alarm.active : !alarm.acked)).map((alarm) => ({ ...alarm, t: alarm.since }));
  }

  function update() {
    tab = picked ?? (live.alarms.some(({ active }) => active) || !live.alarms.length ? "active" : "unacked");
    const counts = { active: live.alarms.filter(({ active }) => active).length, unacked: live.alarms.filter(({ acked }) => !acked).length };
    for (const one of tabs.children) {
      one.setAttribute("aria-pressed", String(one.dataset.tab === tab));
      const [key, text] = TABS.find(([known]) => known === one.dataset.tab);
      say(one, key in counts ? `${text} (${counts[key]})` : text);
    }
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    shown = rows().filter((alarm) => words.every((word) => `${alarm.source} ${spaced(alarm.name)} ${alarm.name} ${alarm.text}`.toLowerCase().includes(word)));
    const found = shown.find((alarm) => keyOf(alarm) === chosen && (!at || alarm.t === at)) ?? shown.find((alarm) => keyOf(alarm) === chosen) ?? shown[0];
    drawList(found);
    drawDetail(found);
    const next = new URLSearchParams(picked ? { show: picked } : {});
    if (chosen) next.set("alarm", chosen);
    if (at) next.set("t", String(at));
    keep(next);
    const old = live.old;
    say(note, old ? `${old.why} These alarms are as of ${clock(old.since)}.` : live.alarmTrouble ? `Alarms are not known: ${live.alarmTrouble}` : tab === "past" && !kept ? `The service keeps no past alarms ([history] in its configuration): shown is what this page has seen. ${why}`
      : tab === "past" && shown.length ? `${counted(shown.length, "time")} in the last 30 days, active for ${span(shown.reduce((sum, { t, until }) => sum + ((until ?? Date.now()) - t) / 1000, 0))} in all.`
      : live.alarmCount > live.alarms.length ? `The worst ${live.alarms.length} of ${live.alarmCount}.` : "");
  }

  function drawList(found) {
    const key = JSON.stringify([shown.map((a) => [a.event, a.t, a.active, a.acked, a.until]), tab, found && [keyOf(found), found.t], Math.floor(Date.now() / 10000)]);
    if (list.dataset.key === key) return;
    list.dataset.key = key;
    const focused = list.contains(document.activeElement) ? document.activeElement.dataset.alarm : null;
    list.replaceChildren(...shown.map((alarm) => h("li", {}, h("button", {
      type: "button", "data-alarm": `${keyOf(alarm)}@${alarm.t}`, "aria-current": alarm === found ? "true" : null,
      onclick: () => { chosen = keyOf(alarm); at = alarm.t; update(); },
    }, h("span.badge", { "data-severity": alarm.active ? alarm.severity : 1 }, stateOf(alarm)), h("strong", {}, alarm.source, h("span.muted", {}, ` · ${spaced(alarm.name)}`)), h("time.muted", {}, clock(alarm.t)), h("span.first", {}, inUnits(parts(alarm.text).measured))))));
    if (!shown.length) {
      list.append(h("li.none", {}, live.old || live.alarmTrouble ? "Not known." : { active: "No alarm is active.", unacked: "Every alarm is acknowledged.", past: "No alarm in the last 30 days." }[tab]));
    }
    if (focused) list.querySelector(`[data-alarm="${CSS.escape(focused)}"]`)?.focus();
  }

  function stateOf({ active, acked, confirmed, until }) {
    if (tab === "past") return active ? "active" : until ? "ended" : "past";
    if (active) return acked ? "active, seen" : "active";
    return acked ? (confirmed ? "dealt with" : "to confirm") : "ended, not seen";
  }

  /** Since when it is so: active alarms since they began, others since they ended, or were acknowledged. */
  const told = ({ active, acked, t }) => `${active ? "since" : acked ? "acknowledged" : "ended"} ${clock(t)}`;

  function drawDetail(alarm) {
    if (!alarm) { detail.hidden = true; delete detail.dataset.key; return; }
    detail.hidden = false;
    const { measured, causes } = parts(inUnits(alarm.text)), [quantity, action] = GUIDES[alarm.name] ?? ["", ""], isService = alarm.source === "Service", kind = live.part(alarm.source)?.kind;
    const key = JSON.stringify([alarm, tab, Math.floor(Date.now() / 10000)]);
    if (detail.dataset.key === key) { showButtons(); return; }
    const isSame = detail.dataset.alarm === `${keyOf(alarm)}@${alarm.t}`;
    detail.dataset.key = key;
    detail.dataset.alarm = `${keyOf(alarm)}@${alarm.t}`;
    if (!isSame) {
      comment.value = "";
      say(done, "");
      askOfChosen.close();
      askOfChosen = ask.within();
    }
    const end = alarm.until ?? (alarm.active ? Date.now() : alarm.t), length = Math.max(AROUND_S, Math.min(3 * (end - alarm.t) / 1000, 86400));
    const isOngoing = alarm.active && Date.now() - alarm.t < 4 * 3600e3;
    const seconds = isOngoing ? Math.max(AROUND_S, 1.5 * (Date.now() - alarm.t) / 1000) : length, to = isOngoing ? Date.now() : alarm.t + 500 * length;
    const trend = `span=${Math.round(seconds)}${isOngoing ? "" : `&end=${Math.round(to / 1000)}`}&at=${Math.round(alarm.t / 1000)}`;
    const hadFocus = detail.contains(document.activeElement) ? document.activeElement : null;
    detail.replaceChildren(
      h("header", {}, h("h2.big", {}, `${alarm.source} · ${spaced(alarm.name)}`), h("span.badge", { "data-severity": alarm.active ? alarm.severity : 1 }, stateOf(alarm)), h("span.fill"),
        h("span.muted", {}, alarm.until ? `${clock(alarm.t)} to ${clock(alarm.until)}, ${span((alarm.until - alarm.t) / 1000)}` : `${told(alarm)}, ${span((Date.now() - alarm.t) / 1000)}${alarm.active ? "" : " ago"}`)),
      h("dl.answers", {},
        h("dt", {}, "What was measured"), h("dd.measured", {}, measured || "Nothing more is known of it.", quantity ? h("small", {}, `This alarm watches: ${quantity}.`) : null),
        causes.length ? [h("dt", {}, "What it may be"), h("dd", {}, h("ul", {}, causes.map((cause) => h("li", {}, cause))))] : [],
        action ? [h("dt", {}, "What to do"), h("dd.action", {}, inUnits(action))] : [],
        alarm.comment || alarm.user ? [h("dt", {}, "Last remark"), h("dd", {}, `${alarm.comment ? `“${alarm.comment}”` : "no comment"}${alarm.user ? `, ${alarm.user}` : ""}`)] : []),
      isService ? null : kind ? h("p.links", {}, kind === "axis" ? h("a.button", { href: `${live.hrefOf(alarm.source)}?${trend}` }, "Trend at that time") : null, h("a.button", { href: live.hrefOf(alarm.source) }, kind === "axis" ? "Axis" : "Line")) : h("p.links", {}, h("a.button", { href: `#/trend/${encodeURIComponent(alarm.source)}?${trend}` }, "Trend at that time"),
        h("a.button", { href: `#/map/${encodeURIComponent(alarm.source)}?at=${Math.round(alarm.t)}` }, "Place in the map"),
        h("a.button", { href: `#/valve/${encodeURIComponent(alarm.source)}` }, "Valve")),
      around.element,
      h("form.form.remark", { onsubmit: (event) => { event.preventDefault(); steps[alarm.acked ? "Comment" : "Acknowledge"].act(); } },
        h("label", {}, "Comment", comment), h("div.buttons", {}, hint, Object.values(steps).map(({ button }) => button)), done));
    around.show(alarm.source, alarm, [to - 1000 * seconds, to], askOfChosen);
    showButtons();
    if (hadFocus?.isConnected) hadFocus.focus();
  }

  function showButtons() {
    for (const one of Object.values(steps)) one.update();
    say(hint, live.old || user.name ? (present() ? steps.Comment.why() : "") : "To acknowledge, log in as an operator of the service.");
  }

  async function act(what, command) {
    say(done, "…");
    const problem = await askOfChosen(command, user.command(command));
    if (problem === undefined) return;
    say(done, problem ?? { Acknowledge: "Acknowledged: it was seen.", Confirm: "Confirmed: its cause was dealt with.", Comment: "The comment is kept." }[what]);
    if (!problem) comment.value = "";
  }

  list.addEventListener("keydown", (event) => {
    const move = { ArrowDown: 1, ArrowUp: -1 }[event.key], all = [...list.querySelectorAll("button")], k = all.indexOf(document.activeElement);
    if (!move || k < 0) return;
    event.preventDefault();
    const next = all[k + move];
    if (next) { const wanted = next.dataset.alarm; next.click(); list.querySelector(`[data-alarm="${CSS.escape(wanted)}"]`)?.focus(); }
  });

  async function readPast() {
    const found = await ask("past", live.past(Date.now() - PAST_MS, Date.now() + 60000));
    if (!found) return;
    if (found.past) { past = merged(past, found.past); kept = found.kept; why = found.why ?? ""; }
    update();
  }
  const onAlarms = () => { past = merged(past, live.alarms); update(); };
  const again = () => { update(); if (!live.old) readPast(); };
  search.addEventListener("input", update);
  live.addEventListener("alarms", onAlarms);
  live.addEventListener("standing", again);
  for (const what of ["change", "rights"]) user.addEventListener(what, update);
  const slow = setInterval(update, 5000);
  mark(root, "stale", live.old !== null);
  update();
  readPast();
  return () => { around.close(); clearInterval(slow); live.removeEventListener("alarms", onAlarms); live.removeEventListener("standing", again); for (const what of ["change", "rights"]) user.removeEventListener(what, update); };
}
