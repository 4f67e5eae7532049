// node-opcua as a plant's server; tests/support/peer.py says what it is told and what it answers.
const { mkdirSync, copyFileSync } = require("node:fs");
const { join } = require("node:path");
const { createInterface } = require("node:readline");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");
const {
  DataType,
  makePermissionFlag,
  MessageSecurityMode,
  resolveNodeId,
  SecurityPolicy,
  StatusCodes,
  Variant,
  VariantArrayType,
} = require("node-opcua-client");
const { OPCUAServer } = require("node-opcua-server");

const SIGNALS = {
  U: DataType.Double,
  p1: DataType.Double,
  p2: DataType.Float,
  Q: DataType.Double,
  T: DataType.Double,
  Sequence: DataType.UInt32,
};
const ANONYMOUS = resolveNodeId("i=15644"); // well-known roles
const OPERATOR = resolveNodeId("i=15680");

let server;
let signals;
let command;

function populate(addressSpace) {
  const plant = addressSpace.registerNamespace("urn:plant");
  const valve = plant.addObject({
    browseName: "V1",
    nodeId: "s=V1",
    organizedBy: addressSpace.rootFolder.objects,
  });
  const variable = (name, options) =>
    plant.addVariable({
      browseName: name,
      nodeId: `s=V1.${name}`,
      componentOf: valve,
      minimumSamplingInterval: 0, // each change is sampled
      accessLevel: "CurrentRead",
      userAccessLevel: "CurrentRead",
      ...options,
    });
  signals = Object.entries(SIGNALS).map(([name, dataType]) => {
    const made = variable(name, { dataType });
    made.setValueFromSource({ dataType: DataType.Null }, StatusCodes.BadWaitingForInitialData);
    return [made, dataType];
  });
  variable("Text", {
    dataType: DataType.String,
    value: new Variant({ dataType: DataType.String, value: "x" }),
  });
  const numbers = { dataType: DataType.Double, arrayType: VariantArrayType.Array, value: [1.0] };
  variable("Array", { dataType: DataType.Double, valueRank: 1, value: new Variant(numbers) });
  command = variable("Command", {
    dataType: DataType.Double,
    accessLevel: "CurrentRead | CurrentWrite",
    userAccessLevel: "CurrentRead | CurrentWrite",
    value: new Variant({ dataType: DataType.Double, value: 0 }),
  });
  command.setRolePermissions([
    { roleId: ANONYMOUS, permissions: makePermissionFlag("Browse | Read") },
    { roleId: OPERATOR, permissions: makePermissionFlag("Browse | Read | Write") },
  ]);
}

const operations = {
  async start({ port, certificate, key, applicationUri, pki, trusted, user, password }) {
    mkdirSync(join(pki, "trusted", "certs"), { recursive: true });
    copyFileSync(trusted, join(pki, "trusted", "certs", "peer.der"));
    server = new OPCUAServer({
      port,
      host: "127.0.0.1",
      hostname: "127.0.0.1",
      resourcePath: "/plant/",
      certificateFile: certificate,
      privateKeyFile: key,
      serverInfo: { applicationUri },
      serverCertificateManager: new OPCUACertificateManager({ rootFolder: pki }),
      securityModes: [MessageSecurityMode.SignAndEncrypt],
      securityPolicies: [SecurityPolicy.Basic256Sha256, SecurityPolicy.Aes256_Sha256_RsaPss],
      allowAnonymous: true,
      userManager: {
        isValidUser: (name, given) => name === user && given === password,
        getUserRoles: (name) => (name === user ? [OPERATOR] : [ANONYMOUS]),
      },
    });
    await server.initialize();
    populate(server.engine.addressSpace);
    await server.start();
    return { url: `opc.tcp://127.0.0.1:${port}/plant/` };
  },

  async sample({ values, code, time }) {
    signals.forEach(([variable, dataType], i) => {
      const status = Object.values(StatusCodes).find((known) => known.value === code);
      const value = code ? { dataType: DataType.Null } : { dataType, value: values[i] };
      variable.setValueFromSource(value, status, new Date(time));
    });
    return {};
  },

  async command() {
    return { value: command.readValue().value.value };
  },

  async stop() {
    await server.shutdown(0);
    return {};
  },
};

async function run() {
  for await (const line of createInterface({ input: process.stdin })) {
    const step = JSON.parse(line);
    let answer;
    try {
      answer = { result: await operations[step.op](step) };
    } catch (error) {
      answer = { error: String(error.stack ?? error), code: null };
    }
    process.stdout.write(`${JSON.stringify(answer)}\n`);
  }
  process.exit(0);
}

run();
