// The page's one connection: what it brings is kept here, and whoever draws asks for it.

import { learnWords } from "./format.js";
import { oldLink, oldPart, oldRow } from "./trust.js";

const RETRY_MS = [300, 1000, 2000];
const SILENT_MS = 4000; // the page hears something every second
const COURSE_MS = 120000;

class Live extends EventTarget {
  link = "connecting";
  text = "";
  url = "";
  start = ""; // why a service that answers does not identify yet
  valves = [];
  parts = []; // axes: {name, kind, family}; their numbers follow those of the valves, among which lines are
  quantities = []; // of each estimator: name, heading, decimals, about
  rows = new Map(); // valve number → {severity, reason, since, rmse, noise, samples, silent, predicted, health}
  courses = new Map(); // valve number → [[t in ms, Q̂], …] of the last two minutes
  alarms = []; // those that need somebody, worst first
  alarmCount = 0;
  alarmTrouble = ""; // why they are not known
  get hasAllAlarms() { return !this.old && !this.alarmTrouble && this.alarms.length === this.alarmCount; }

  events = [];
  heardAt = performance.now();
  #values = new Map(); // name → {value, code, t} of the watched valve
  #names = [];
  #socket = null;
  #failures = 0;
  #watch = { valve: null, estimator: null, overview: true, fromAfar: false };
  #asked = new Map();
  #question = 0;
  #layout = "";
  #opened = false;
  #newest = { t: 0, at: 0 }; // of the watched part: time of its newest value, and when that came

  constructor() {
    super();
    this.#connect();
  }

  /** Say what is in view; the rest is not sent. `fromAfar`: a value each second is enough, which costs the service nothing. */
  watch(valve, estimator = null, fromAfar = false) {
    const wish = { valve, estimator, overview: true, fromAfar };
    if (JSON.stringify(wish) === JSON.stringify(this.#watch)) return;
    if (valve !== this.#watch.valve) {
      this.#values.clear();
      this.#newest = { t: 0, at: performance.now() };
    }
    this.#watch = wish;
    this.#send({ watch: wish });
  }

  get watched() { return this.#watch.valve; }

  /** A valve's number: {value, code, t}, or undefined. */
  get(name) { return this.#values.get(name); }

  number(name) {
    const value = this.#values.get(name)?.value;
    return typeof value === "number" ? value : NaN;
  }

  /** A valve's array; empty where it is none, as of a node that may not be read. */
  list(name) {
    const value = this.#values.get(name)?.value;
    return Array.isArray(value) || ArrayBuffer.isView(value) ? value : [];
  }

  /** good, uncertain or bad: how far a value can be trusted. */
  quality(name) {
    const entry = this.#values.get(name);
    return entry ? ["good", "uncertain", "bad", "bad"][entry.code >>> 30] : "none";
  }

  has(name) { return this.#values.has(name); }

  names() { return [...this.#values.keys()]; }

  /** Why nothing that is shown is of now: {state, label, why, since (ms), advice}; null while all is well. */
  get old() {
    const silent = performance.now() - this.heardAt;
    const state = this.link === "up" && silent > SILENT_MS ? "page" : this.link;
    return state === "up" ? null : oldLink(state, state === "page" ? Date.now() - silent : this.since);
  }

  /** The same of one valve, line or axis, whose samples may have ended while all else goes on. */
  oldOf(name) {
    if (this.old) return this.old;
    const row = this.rowOf(name);
    if (row) return oldRow(row, this.start);
    if (!this.parts.some((part) => part.name === name) || name !== this.watched) return null;
    return oldPart(this.#newest.t, (performance.now() - this.#newest.at) / 1000, this.quality("Inverse.RequiredU") === "bad");
  }

  /** A valve's or line's row of the overview; undefined where none is known. */
  rowOf(name) { return this.rows.get(this.valves.findIndex((valve) => valve.name === name)); }

  /** The line or axis of that name. */
  part(name) { return [...this.parts, ...this.valves].find((known) => known.kind && known.name === name); }

  /** Where a valve, edge, line or axis is shown. */
  hrefOf(name) { return `#/${this.part(name)?.kind ?? "valve"}/${encodeURIComponent(name)}`; }

  /** Which voltage a flow demands: the service's own answer; nothing is written. */
  invert(valve, Q, dp) { return this.#ask({ invert: valve, Q, dp }); }

  /** The same for a speed of an axis, at its newest pressures. */
  invertSpeed(axis, v) { return this.#ask({ invert: axis, v }); }

  /** Courses of variables over a span in ms: {start, step, since (ms), kept, courses: [[mean, least, largest], …], doubts: by course 0 where all values of an interval are Good, 1 some, 2 none}. */
  trend(valve, names, from, to, step) { return this.#ask({ trend: valve, names, from: Math.floor(from), to: Math.ceil(to), step }); }

  /** Changes of alarms in a span in ms, the newest first: {past, kept}. */
  past(from, to) { return this.#ask({ past: true, from: Math.floor(from), to: Math.ceil(to) }); }

  /** How the present map differs from the approved one: {mean, largest, U, dp, points}. */
  compare(valve, estimator) { return this.#ask({ compare: valve, estimator }); }

  /** The newest seconds of all axes with a set position: {tracking: [{name, rms, t, x, set}]}. */
  tracking() { return this.#ask({ tracking: true }); }

  #ask(question) {
    const number = ++this.#question;
    return new Promise((resolve) => {
      if (!this.#send({ ask: number, ...question })) resolve({ error: "not connected" });
      else this.#asked.set(number, resolve);
    });
  }

  #send(message) {
    if (this.#socket?.readyState !== WebSocket.OPEN) return false;
    this.#socket.send(JSON.stringify(message));
    return true;
  }

  #connect() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(`${scheme}//${location.host}/live`);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    socket.onopen = () => {
      this.#failures = 0;
      this.#opened = true;
      this.#names = [];
      this.events = [];
      this.rows.clear();
      this.#send({ watch: this.#watch });
    };
    socket.onmessage = ({ data }) => {
      this.heardAt = performance.now();
      if (typeof data === "string") this.#takeText(JSON.parse(data));
      else this.#takeBinary(new DataView(data));
    };
    socket.onclose = () => {
      for (const resolve of this.#asked.values()) resolve({ error: "not connected" });
      this.#asked.clear();
      if (this.#opened) this.#setLink("page", "The page's own server does not answer.");
      setTimeout(() => this.#connect(), RETRY_MS[Math.min(this.#failures++, RETRY_MS.length - 1)]);
    };
  }

  #setLink(link, text) {
    this.link = link;
    this.text = text;
    this.dispatchEvent(new Event("link"));
  }

  #takeText(message) {
    if (message.link) {
      this.url = message.url;
      this.since = message.since;
      this.start = message.start;
      Object.assign(this, { link: message.link, text: message.text }); // views are drawn on what is so now
      this.valves = message.valves;
      this.parts = message.parts;
      this.quantities = message.quantities;
      learnWords(message.words);
      const layout = JSON.stringify([message.generation, message.valves, message.parts]); // another server counts anew
      if (this.#layout !== layout) {
        this.#layout = layout;
        this.#values.clear();
        this.courses.clear();
        this.dispatchEvent(new Event("layout"));
      }
      this.#setLink(message.link, message.text);
    } else if (message.names) {
      message.names.forEach((name, k) => { this.#names[message.from + k] = name; });
    } else if (message.texts) {
      if (this.#isWatched(message.valve)) {
        for (const [name, value] of Object.entries(message.texts)) this.#values.set(name, { value, code: 0, t: 0 });
        this.dispatchEvent(new Event("values"));
      }
    } else if (message.events) {
      for (const [number, t, valve, kind, severity, text] of message.events) {
        this.events.push({ number, t, valve, kind, severity, text });
      }
      this.events.splice(0, this.events.length - 500);
      this.dispatchEvent(new Event("events"));
    } else if (message.alarms) {
      Object.assign(this, { alarms: message.alarms, alarmCount: message.of, alarmTrouble: message.trouble });
      this.dispatchEvent(new Event("alarms"));
    } else if (message.answer) {
      this.#asked.get(message.answer)?.(message);
      this.#asked.delete(message.answer);
    }
  }

  #isWatched(number) { return (this.valves[number] ?? this.parts[number - this.valves.length])?.name === this.#watch.valve; }

  #takeBinary(view) {
    const kind = view.getUint8(0);
    if (kind === 1) this.#takeNumbers(view);
    else if (kind === 2) this.#takeMatrix(view);
    else if (kind === 3) this.#takeRows(view);
    else if (kind === 4) this.#takeTrend(view);
  }

  #takeNumbers(view) {
    if (!this.#isWatched(view.getUint16(2, true))) return;
    const n = view.getUint32(4, true);
    const times = 8 + 8 * n, codes = times + 8 * n, names = codes + 4 * n;
    for (let k = 0; k < n; k++) {
      const t = view.getFloat64(times + 8 * k, true);
      this.#values.set(this.#names[view.getUint16(names + 2 * k, true)], { value: view.getFloat64(8 + 8 * k, true), t, code: view.getUint32(codes + 4 * k, true) });
      if (t > this.#newest.t) this.#newest = { t, at: performance.now() };
    }
    this.dispatchEvent(new Event("values"));
  }

  #takeMatrix(view) {
    if (!this.#isWatched(view.getUint16(2, true))) return;
    const rows = view.getUint32(8, true), columns = view.getUint32(12, true);
    const value = [];
    for (let i = 0, at = 24; i < rows; i++) {
      const row = new Float64Array(columns);
      for (let j = 0; j < columns; j++, at += 8) row[j] = view.getFloat64(at, true);
      value.push(row);
    }
    const name = this.#names[view.getUint16(4, true)];
    this.#values.set(name, { value: rows === 1 ? value[0] : value, code: 0, t: view.getFloat64(16, true) });
    this.dispatchEvent(new CustomEvent("matrix", { detail: name }));
  }

  #note(valve, predicted) {
    const course = this.courses.get(valve) ?? [], now = Date.now();
    course.push([now, predicted]);
    while (course[0][0] < now - COURSE_MS) course.shift();
    this.courses.set(valve, course);
  }

  #takeTrend(view) {
    const courses = view.getUint16(2, true), number = view.getUint32(4, true), n = view.getUint32(32, true);
    const read = (at) => Float32Array.from({ length: n }, (_, k) => view.getFloat32(at + 4 * k, true));
    const found = Array.from({ length: courses }, (_, c) => [0, 1, 2].map((k) => read(36 + 4 * n * (3 * c + k))));
    const [start, step, since] = [8, 16, 24].map((at) => view.getFloat64(at, true)), behind = 36 + 12 * n * courses;
    const doubts = Array.from({ length: courses }, (_, c) => Uint8Array.from({ length: n }, (_, k) => view.getUint8(behind + n * c + k)));
    this.#asked.get(number)?.({ start, step, since, kept: view.getUint8(1) === 1, courses: found, doubts });
    this.#asked.delete(number);
  }

  #takeRows(view) {
    const columns = view.getUint8(1), n = view.getUint32(4, true);
    for (let k = 0; k < n; k++) {
      const at = 8 + 8 * columns * k;
      const [severity, reason, since, rmse, noise, samples, silent, predicted, health] =
        Array.from({ length: columns }, (_, j) => view.getFloat64(at + 8 * j, true));
      const valve = view.getUint16(8 + 8 * columns * n + 2 * k, true);
      this.#note(valve, predicted);
      this.rows.set(valve, { severity, reason, since, rmse, noise, samples, silent, predicted, health });
    }
    this.dispatchEvent(new Event("rows"));
  }
}

export const live = new Live();
