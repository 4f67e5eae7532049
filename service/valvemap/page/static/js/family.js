// Tabs of what belongs together: edges and lines of one valve with ports, or all axes.

import { h } from "./dom.js";

/** A row of links, or nothing for a valve that stands alone; a view of valves stays the same view. */
export function familyTabs(live, view, item) {
  const isAxis = item.kind === "axis", key = view.of === "valve" ? view.key : "valve";
  const own = isAxis ? [] : live.valves.filter(({ family }) => family && family === item.family);
  const edges = own.filter(({ kind }) => !kind), parts = isAxis ? live.parts : own.filter(({ kind }) => kind);
  const links = [...edges.map(({ name }) => [name, `#/${key}/${encodeURIComponent(name)}`]), ...parts.map(({ name }) => [name, live.hrefOf(name)])];
  if (links.length < 2) return null;
  const label = (name) => (isAxis ? name : name.slice(item.family.length + 1).replace(/^Line/, "Line "));
  return h("nav.tabs", { "aria-label": isAxis ? "Axes" : `Edges and lines of ${item.family}` },
    h("span.muted", {}, isAxis ? "Axes" : item.family), links.map(([name, href]) => h("a", { href, "aria-current": name === item.name ? "page" : null }, label(name))));
}
