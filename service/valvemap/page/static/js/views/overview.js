// All valves, worst first: why, and since when.

import { h, mark, say } from "../dom.js";
import { clock, count, counted, fixed, REASONS, span } from "../format.js";

const byName = new Intl.Collator("en", { numeric: true }).compare;
const HEIGHT = 34; // px of a row; as in page.css
const PADDING = 24; // px around the table
const MARGIN = 4; // rows drawn above and below what is seen
const COLUMNS = [
  ["severity", "State", "140px", ""], ["name", "Valve", "22%", ""], ["why", "Why", "", ""],
  ["since", "Since", "150px", ""], ["rmse", "RMSE, l/min", "110px", ".number"],
  ["predicted", "Q̂, l/min", "100px", ".number"], ["samples", "Samples", "120px", ".number"],
];

export function overviewView(root, { live }) {
  const search = h("input", { type: "search", placeholder: "Search valves and reasons  ( / )", "aria-label": "Search", size: 30 });
  const counts = h("span.counts"), table = h("tbody"), body = h("div.rows.card", { tabindex: 0, role: "region", "aria-label": "Valves" });
  const top = h("tr", { "aria-hidden": "true" }, h("td", { colspan: COLUMNS.length })), bottom = top.cloneNode(true);
  let order = { by: "severity", down: true }, rows = [], drawn = [], seen = 0;

  const heads = COLUMNS.map(([key, title, width, kind]) => h(`th${kind}`, { style: width ? { width } : {}, scope: "col" },
    h("button", { type: "button", onclick: () => { order = { by: key, down: order.by === key ? !order.down : key !== "name" }; sort(); } }, title)));
  body.append(h("table", {}, h("thead", {}, h("tr", {}, heads)), table));
  table.append(top, bottom);
  root.append(h("div.head", {}, h("h1", {}, "All valves"), counts, h("span.fill"), search), body);

  function sort() {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    rows = live.valves.map(({ name }, number) => ({ name, number, ...live.rows.get(number) })).filter((row) => row.severity !== undefined)
      .filter((row) => !words.length || words.every((word) => `${row.name} ${REASONS[row.reason].join(" ")}`.toLowerCase().includes(word)));
    const key = { severity: (r) => 1000 * r.severity + r.reason, why: (r) => r.reason, name: (r) => r.name }[order.by] ?? ((r) => r[order.by]);
    const sign = order.down ? -1 : 1;
    rows.sort((a, b) => {
      const [x, y] = [key(a), key(b)];
      if (typeof x === "string") return sign * byName(x, y);
      return sign * ((x || 0) - (y || 0)) || a.since - b.since || a.number - b.number;
    });
    heads.forEach((head, k) => {
      if (COLUMNS[k][0] === order.by) head.setAttribute("aria-sort", order.down ? "descending" : "ascending");
      else head.removeAttribute("aria-sort");
    });
    const of = [0, 0, 0, 0];
    for (const row of live.rows.values()) of[row.severity] += 1;
    const words_ = [null, "note", "warning", "alarm"];
    body.style.maxHeight = `${HEIGHT * (rows.length + 1) + PADDING}px`;
    counts.replaceChildren(...[3, 2, 1, 0].filter((k) => of[k]).map((k) => h("span.badge", { "data-severity": k }, k ? counted(of[k], words_[k]) : `${of[k]} good`)));
    draw();
  }

  /** Only the rows that are seen exist. */
  function draw() {
    const first = Math.max(Math.floor(body.scrollTop / HEIGHT) - MARGIN, 0);
    const last = Math.min(first + Math.ceil(seen / HEIGHT) + 2 * MARGIN, rows.length);
    top.firstChild.style.height = `${first * HEIGHT}px`;
    bottom.firstChild.style.height = `${(rows.length - last) * HEIGHT}px`;
    top.hidden = first === 0;
    bottom.hidden = last === rows.length;
    while (drawn.length > last - first) drawn.pop().remove();
    while (drawn.length < last - first) {
      const row = h("tr", {}, h("td", {}, h("span.badge")), h("td", {}, h("a")), h("td"), h("td"), h("td.number"), h("td.number"), h("td.number"));
      drawn.push(row);
      bottom.before(row);
    }
    drawn.forEach((element, k) => fill(element, rows[first + k]));
  }

  function fill(element, row) {
    const [state, name, why, since, rmse, predicted, samples] = element.cells;
    mark(state.firstChild, "severity", row.severity);
    say(state.firstChild, REASONS[row.reason][0]);
    const href = `#/valve/${encodeURIComponent(row.name)}`;
    if (name.firstChild.getAttribute("href") !== href) name.firstChild.setAttribute("href", href);
    say(name.firstChild, row.name);
    say(why, row.silent > 3 ? `No new sample for ${span(row.silent)}.` : REASONS[row.reason][1]);
    say(since, clock(row.since));
    say(rmse, fixed(row.rmse, 2));
    say(predicted, fixed(row.predicted, 1));
    say(samples, count(row.samples));
  }

  /** Once before the next frame, however often it is asked for. */
  function soon(what) {
    let due = 0;
    return () => { due ||= requestAnimationFrame(() => { due = 0; what(); }); };
  }

  search.addEventListener("input", soon(sort));
  body.addEventListener("scroll", soon(draw), { passive: true });
  const resize = new ResizeObserver(() => { seen = body.clientHeight; draw(); });
  resize.observe(body);
  live.addEventListener("rows", sort);
  sort();
  return () => { live.removeEventListener("rows", sort); resize.disconnect(); };
}
