// A host of Sparkplug B: subscribes to everything, says that it is there, decodes what comes with
// the library of Cirrus Link, and writes one JSON object a line. A line on standard input is a
// request for births.
"use strict";
const mqtt = require("mqtt");
const sparkplug = require("sparkplug-payload").get("spBv1.0");

const [url, group, node, host] = process.argv.slice(2);
const state = `spBv1.0/STATE/${host}`;
let began = Date.now();
const said = (online) => JSON.stringify({ online, timestamp: began });
const client = mqtt.connect(url, {
  reconnectPeriod: 50,
  clean: true,
  will: { topic: state, payload: said(false), qos: 1, retain: true },
});
const names = new Map();

client.on("connect", () => {
  client.subscribe(`spBv1.0/${group}/#`, { qos: 1 }, () => {
    client.publish(state, said(true), { qos: 1, retain: true });
    write({ verb: "CONNECTED" });
  });
});

client.on("message", (topic, data) => {
  const [, , verb, , device] = topic.split("/");
  const payload = sparkplug.decodePayload(data);
  if (verb === "NBIRTH") names.clear();
  const metrics = (payload.metrics || []).flatMap(singles).map((metric) => {
    const alias = metric.alias === undefined || metric.alias === null ? null : String(metric.alias);
    if (verb.endsWith("BIRTH") && alias !== null) names.set(alias, metric.name);
    return {
      name: metric.name || names.get(alias) || null,
      alias,
      type: metric.type,
      template: metric.template || null,
      value: plain(metric.value),
      t: Number(metric.timestamp),
      isNull: Boolean(metric.isNull),
      isHistorical: Boolean(metric.isHistorical),
      quality: metric.properties ? metric.properties.Quality.value : null,
    };
  });
  const seq = payload.seq === undefined || payload.seq === null ? null : Number(payload.seq);
  write({ topic, verb, device: device || null, seq, metrics });
});
client.on("error", () => {});

process.stdin.on("data", () => {
  const metrics = [{ name: "Node Control/Rebirth", type: "Boolean", value: true }];
  const payload = sparkplug.encodePayload({ timestamp: Date.now(), metrics });
  client.publish(`spBv1.0/${group}/NCMD/${node}`, payload);
});

// The members of an instance under its name, each as a metric; all else as it is.
function singles(metric) {
  if (metric.type !== "Template" || metric.value.isDefinition) return [metric];
  return metric.value.metrics.map((one) => ({
    ...one,
    name: one.name && metric.name ? `${metric.name}/${one.name}` : one.name,
    template: metric.value.templateRef,
  }));
}

function plain(value) {
  if (value === null || value === undefined) return null;
  return typeof value === "object" ? Number(value) : value;
}

function write(line) {
  process.stdout.write(`${JSON.stringify(line)}\n`);
}
