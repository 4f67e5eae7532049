// The page's one connection: what it brings is kept here, and whoever draws asks for it.

import { learnWords } from "./format.js";

const RETRY_MS = [300, 1000, 2000];

export class Live extends EventTarget {
  link = "connecting";
  text = "";
  url = "";
  valves = [];
  quantities = []; // of each estimator: name, heading, decimals, about
  rows = new Map(); // valve number → {severity, reason, since, rmse, noise, samples, silent, predicted}
  events = [];
  heardAt = performance.now();
  #values = new Map(); // name → {value, code, t} of the watched valve
  #names = [];
  #socket = null;
  #failures = 0;
  #watch = { valve: null, estimator: null, overview: true };
  #asked = new Map();
  #question = 0;
  #generation = null;
  #opened = false;

  constructor() {
    super();
    this.#connect();
  }

  /** Say what is in view; the rest is not sent. */
  watch(valve, estimator = null, overview = true) {
    const wish = { valve, estimator, overview };
    if (JSON.stringify(wish) === JSON.stringify(this.#watch)) return;
    if (valve !== this.#watch.valve) this.#values.clear();
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

  /** good, uncertain or bad: how far a value can be trusted. */
  quality(name) {
    const entry = this.#values.get(name);
    return entry ? ["good", "uncertain", "bad", "bad"][entry.code >>> 30] : "none";
  }

  has(name) { return this.#values.has(name); }

  names() { return [...this.#values.keys()]; }

  /** Which voltage a flow demands: the service's own answer; nothing is written. */
  invert(valve, Q, dp) {
    const number = ++this.#question;
    return new Promise((resolve) => {
      if (!this.#send({ ask: number, invert: valve, Q, dp })) resolve({ error: "not connected" });
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
      this.valves = message.valves;
      this.quantities = message.quantities;
      learnWords(message.words);
      if (this.#generation !== message.generation) {
        this.#generation = message.generation;
        this.#values.clear();
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
    } else if (message.answer) {
      this.#asked.get(message.answer)?.(message);
      this.#asked.delete(message.answer);
    }
  }

  #isWatched(number) { return this.valves[number]?.name === this.#watch.valve; }

  #takeBinary(view) {
    const kind = view.getUint8(0);
    if (kind === 1) this.#takeNumbers(view);
    else if (kind === 2) this.#takeMatrix(view);
    else if (kind === 3) this.#takeRows(view);
  }

  #takeNumbers(view) {
    if (!this.#isWatched(view.getUint16(2, true))) return;
    const n = view.getUint32(4, true);
    const times = 8 + 8 * n, codes = times + 8 * n, names = codes + 4 * n;
    for (let k = 0; k < n; k++) {
      this.#values.set(this.#names[view.getUint16(names + 2 * k, true)], {
        value: view.getFloat64(8 + 8 * k, true),
        t: view.getFloat64(times + 8 * k, true),
        code: view.getUint32(codes + 4 * k, true),
      });
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

  #takeRows(view) {
    const columns = view.getUint8(1), n = view.getUint32(4, true);
    for (let k = 0; k < n; k++) {
      const at = 8 + 8 * columns * k;
      const [severity, reason, since, rmse, noise, samples, silent, predicted] =
        Array.from({ length: columns }, (_, j) => view.getFloat64(at + 8 * j, true));
      const valve = view.getUint16(8 + 8 * columns * n + 2 * k, true);
      this.rows.set(valve, { severity, reason, since, rmse, noise, samples, silent, predicted });
    }
    this.dispatchEvent(new Event("rows"));
  }
}
