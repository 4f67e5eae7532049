// From the changes of alarms to the spans in which they were active. Pure.

/** Changes [{source, name, t, active, …}], any order → [{source, name, from, to, severity, text, raised}], the oldest first; `to` is null while active. Where not all changes are known, a span whose begin is missing has none. */
export function activeSpans(changes, areAllKnown = true) {
  const open = new Map(), found = [];
  for (const change of [...changes].sort((a, b) => a.t - b.t)) {
    const key = `${change.source}/${change.name}`, since = open.get(key);
    if (change.active && !since) {
      const begun = { source: change.source, name: change.name, from: change.since ?? change.t, to: null, severity: change.severity, text: change.text, raised: change };
      open.set(key, begun);
      found.push(begun);
    } else if (!change.active && since) {
      since.to = change.since ?? change.t;
      open.delete(key);
    } else if (!change.active && !since && !found.some((one) => one.source === change.source && one.name === change.name)) {
      found.push({ source: change.source, name: change.name, from: areAllKnown ? -Infinity : change.t, to: change.t, severity: change.severity, text: change.text, raised: change });
    }
    if (change.active && since) since.severity = Math.max(since.severity, change.severity);
  }
  return found;
}

/** Spans of alarms, of which the present ones decide what is still active: a clock that steps, or a late sample, may report an end before the begin. `isAll`: every present alarm is among them. */
export function endedSpans(spans, present, isAll) {
  return spans.map((one) => {
    const now = present.find(({ source, name }) => source === one.source && name === one.name);
    if (one.to !== null || (now ? now.active : !isAll)) return one;
    return { ...one, to: Math.max(one.from, now?.t ?? one.from) };
  });
}

/** Spans of a valve's states, the oldest first: {from, to, severity, text}; from the events of the time line, and the present state {since, severity, text}. */
export function stateSpans(events, valve, present) {
  const changes = events.filter((event) => event.kind === "status" && event.valve === valve).sort((a, b) => a.t - b.t);
  const begun = changes.map(({ t, severity, text }) => ({ from: t, severity, text }));
  if (present && !(begun.at(-1)?.from >= present.since)) begun.push({ from: present.since, severity: present.severity, text: present.text });
  return begun.map((one, k) => ({ ...one, to: begun[k + 1]?.from ?? null }));
}

/** Past and present changes without doubles, by EventId. */
export function merged(...lists) {
  const found = new Map();
  for (const change of lists.flat()) found.set(`${change.source}/${change.name}/${change.event}`, change);
  return [...found.values()];
}

/** Text of an alarm → what was measured, since when, what it may be. */
export function parts(text) {
  const [measured, causes = ""] = text.split(" It may be: ");
  return { measured, causes: causes.replace(/\.$/, "").split("; ").filter(Boolean) };
}
