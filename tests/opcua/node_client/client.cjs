// Runs a plan against an OPC UA server and prints what it found.
//
// stdin:  {"url", "security"?: {"policy", "certificate", "key", "pki"}, "user"?, "password"?,
//          "steps": [{"op": "browse" | "read" | "write" | "call" | "subscribe", ...}]}
// stdout: {"results": [...]} or {"error": "..."}; numbers that JSON lacks are "NaN", "Infinity".
const { readFileSync } = require("node:fs");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");
const {
  AttributeIds,
  ClientMonitoredItemGroup,
  DataChangeFilter,
  DataChangeTrigger,
  DataType,
  DeadbandType,
  makeBrowsePath,
  MessageSecurityMode,
  OPCUAClient,
  SecurityPolicy,
  TimestampsToReturn,
  UserTokenType,
  Variant,
  VariantArrayType,
} = require("node-opcua-client");

const plan = JSON.parse(readFileSync(0, "utf8"));

function shown(dataValue) {
  const time = dataValue.sourceTimestamp;
  return {
    type: DataType[dataValue.value?.dataType ?? 0],
    dimensions: dataValue.value?.dimensions ?? null,
    value: plain(dataValue.value?.value),
    status: dataValue.statusCode.name,
    time: time ? time.getTime() : null,
    picoseconds: dataValue.sourcePicoseconds ?? 0,
  };
}

function plain(value) {
  if (value === null || value === undefined) return null;
  if (typeof value === "number") return Number.isFinite(value) ? value : String(value);
  if (typeof value !== "object") return value;
  if (ArrayBuffer.isView(value) || Array.isArray(value)) return Array.from(value, plain);
  return JSON.parse(JSON.stringify(value)); // a structure
}

function variant({ type, value }) {
  const dataType = DataType[type];
  const number = (v) => (typeof v === "string" && type !== "String" ? Number(v) : v);
  return Array.isArray(value)
    ? new Variant({ dataType, arrayType: VariantArrayType.Array, value: value.map(number) })
    : new Variant({ dataType, value: number(value) });
}

// node-opcua knows "ns=" only; our ids name the namespace.
function id(session, text) {
  const match = /^nsu=([^;]+);(.*)$/s.exec(text);
  return match ? `ns=${session.getNamespaceIndex(match[1])};${match[2]}` : text;
}

const operations = {
  async browse(session, { path, namespace }) {
    const index = session.getNamespaceIndex(namespace);
    const relative = path.map((name) => `/${index}:${name}`).join("");
    const found = await session.translateBrowsePath(makeBrowsePath("ObjectsFolder", relative));
    if (found.statusCode.name !== "Good") return { status: found.statusCode.name };
    const node = found.targets[0].targetId;
    const { references } = await session.browse(node);
    return {
      status: "Good",
      node: node.toString(),
      children: references.map((reference) => reference.browseName.name),
    };
  },

  async read(session, { node, attribute = "Value" }) {
    return shown(await session.read({ nodeId: id(session, node), attributeId: AttributeIds[attribute] }));
  },

  async property(session, { node, name }) {
    const found = await session.translateBrowsePath(makeBrowsePath(id(session, node), `.${name}`));
    if (found.statusCode.name !== "Good") return { status: found.statusCode.name };
    return shown(await session.read({ nodeId: found.targets[0].targetId }));
  },

  async write(session, { node, value }) {
    const dataValue = { value: variant(value) };
    const status = await session.write({
      nodeId: id(session, node),
      attributeId: AttributeIds.Value,
      value: dataValue,
    });
    return { status: status.name };
  },

  async call(session, { owner, method, inputs }) {
    const result = await session.call({
      objectId: id(session, owner),
      methodId: id(session, method),
      inputArguments: inputs.map(variant),
    });
    return {
      status: result.statusCode.name,
      inputs: (result.inputArgumentResults ?? []).map((status) => status.name),
      outputs: (result.outputArguments ?? []).map((output) => plain(output.value)),
    };
  },

  async subscribe(session, { nodes, seconds, interval = 50, queue = 1000, deadband = null }) {
    const subscription = await session.createSubscription2({
      requestedPublishingInterval: interval,
      requestedLifetimeCount: 600,
      requestedMaxKeepAliveCount: 20,
      maxNotificationsPerPublish: 0,
      publishingEnabled: true,
      priority: 0,
    });
    const changes = nodes.map(() => []);
    const filter = new DataChangeFilter({
      trigger: deadband ? DataChangeTrigger.StatusValue : DataChangeTrigger.StatusValueTimestamp,
      deadbandType: deadband ? DeadbandType[deadband.type] : DeadbandType.None,
      deadbandValue: deadband ? deadband.value : 0,
    });
    const group = ClientMonitoredItemGroup.create(
      subscription,
      nodes.map((node) => ({ nodeId: id(session, node), attributeId: AttributeIds.Value })),
      { samplingInterval: 0, queueSize: queue, discardOldest: true, filter },
      TimestampsToReturn.Both,
    );
    group.on("changed", (_item, dataValue, index) => changes[index].push(shown(dataValue)));
    await new Promise((resolve) => setTimeout(resolve, seconds * 1000));
    await subscription.terminate();
    return { interval: subscription.publishingInterval, changes };
  },
};

async function run() {
  const options = {
    applicationName: "valvemap-node-client",
    endpointMustExist: false,
    keepSessionAlive: true,
    connectionStrategy: { maxRetry: 0, initialDelay: 100 },
  };
  if (plan.security) {
    options.securityMode = MessageSecurityMode.SignAndEncrypt;
    options.securityPolicy = SecurityPolicy[plan.security.policy];
    options.certificateFile = plan.security.certificate;
    options.privateKeyFile = plan.security.key;
    options.applicationUri = plan.security.applicationUri;
    options.clientCertificateManager = new OPCUACertificateManager({
      rootFolder: plan.security.pki,
      automaticallyAcceptUnknownCertificate: true,
    });
  }
  const client = OPCUAClient.create(options);
  await client.connect(plan.url);
  try {
    const identity = plan.user
      ? { type: UserTokenType.UserName, userName: plan.user, password: plan.password }
      : { type: UserTokenType.Anonymous };
    const session = await client.createSession(identity);
    await session.readNamespaceArray();
    const results = [];
    for (const { op, ...step } of plan.steps) results.push(await operations[op](session, step));
    await session.close();
    return { results };
  } finally {
    await client.disconnect();
  }
}

run()
  .catch((error) => ({ error: String(error.message ?? error) }))
  .then((outcome) => process.stdout.write(JSON.stringify(outcome), () => process.exit(0)));
