// node-opcua as a plant that writes a tag when it changes: two valves, without security.
const { DataType, MessageSecurityMode, SecurityPolicy, StatusCodes, Variant } = require("node-opcua-client");
const { OPCUAServer } = require("node-opcua-server");

const PERIOD_MS = 50;
const NOISE = 0.4; // l/min, one standard deviation
const port = Number(process.argv[2]);

let seed = 20260714;
const uniform = () => {
  seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0;
  return seed / 2 ** 32;
};
const normal = () =>
  Math.sqrt(-2 * Math.log(1 - uniform())) * Math.cos(2 * Math.PI * uniform());

function valve(namespace, folder, name) {
  const tag = (signal) =>
    namespace.addVariable({
      browseName: signal,
      nodeId: `s=${name}.${signal}`,
      componentOf: folder,
      dataType: DataType.Double,
      minimumSamplingInterval: 0,
      value: new Variant({ dataType: DataType.Double, value: 0 }),
    });
  const tags = Object.fromEntries(["Sollwert", "pZulauf", "pRuecklauf", "Durchfluss"].map((s) => [s, tag(s)]));
  const last = {};
  return (signal, value) => {
    if (last[signal] === value) return; // nothing is written that does not change
    last[signal] = value;
    tags[signal].setValueFromSource({ dataType: DataType.Double, value }, StatusCodes.Good);
  };
}

async function run() {
  const server = new OPCUAServer({
    port,
    host: "127.0.0.1",
    hostname: "127.0.0.1",
    resourcePath: "/plc/",
    securityModes: [MessageSecurityMode.None],
    securityPolicies: [SecurityPolicy.None],
  });
  await server.initialize();
  const namespace = server.engine.addressSpace.registerNamespace("urn:plc");
  const folder = (name) =>
    namespace.addObject({
      browseName: name,
      nodeId: `s=${name}`,
      organizedBy: server.engine.addressSpace.rootFolder.objects,
    });
  const write = ["Ventil1", "Ventil2"].map((name) => valve(namespace, folder(name), name));
  const state = [
    { U: 50, p2: 40 },
    { U: 30, p2: 60 },
  ];
  let k = 0;
  const step = () => {
    state.forEach((now, i) => {
      if (k % (6 + i) === 0) now.U = Math.round(5 + 90 * uniform());
      if (k % (4 + i) === 0) now.p2 = Math.round(10 + 140 * uniform());
      const gain = i === 0 ? 0.1 : 0.08;
      const Q = gain * now.U * Math.sqrt(200 - now.p2) + NOISE * normal();
      write[i]("Sollwert", now.U);
      write[i]("pZulauf", 200); // held still
      write[i]("pRuecklauf", now.p2);
      write[i]("Durchfluss", Math.round(Q * 10) / 10);
    });
    k += 1;
  };
  step();
  await server.start();
  setInterval(step, PERIOD_MS);
  process.stdout.write("ready\n");
  process.stdin.on("end", () => server.shutdown(0).then(() => process.exit(0)));
  process.stdin.resume();
}

run();
