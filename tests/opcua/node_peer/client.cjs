// node-opcua as a client; tests/support/peer.py says what it is told and what it answers.
const { createInterface } = require("node:readline");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");
const {
  AttributeIds,
  BrowseDirection,
  ClientMonitoredItem,
  ClientSubscription,
  DataChangeFilter,
  DataChangeTrigger,
  DataType,
  DeadbandType,
  MessageSecurityMode,
  MonitoringMode,
  NodeClass,
  OPCUAClient,
  SecurityPolicy,
  StatusCodes,
  TimestampsToReturn,
  UserTokenType,
  Variant,
  callMethodCondition,
  constructEventFilter,
  installAlarmMonitoring,
  ofType,
} = require("node-opcua-client");
const {
  HistoryReadRequest,
  ReadProcessedDetails,
  ReadRawModifiedDetails,
} = require("node-opcua-service-history");

const BROWSED_AT_ONCE = 100;
const connections = new Map();

function shown(dataValue) {
  const time = dataValue.sourceTimestamp;
  const variant = dataValue.value;
  const structure = DataType[variant?.dataType] === "ExtensionObject";
  return {
    type: structure ? variant.value?.schema?.name : DataType[variant?.dataType ?? 0],
    dimensions: variant?.dimensions ?? null,
    value: plain(variant?.value, DataType[variant?.dataType ?? 0]),
    code: dataValue.statusCode.value,
    time: time ? time.getTime() : null,
  };
}

function plain(value, type) {
  if (value === null || value === undefined) return null;
  if (typeof value === "number") return Number.isFinite(value) ? value : String(value);
  if (typeof value !== "object") return value;
  if (type === "UInt64" && value.length === 2 && typeof value[0] === "number")
    return value[0] * 2 ** 32 + value[1];
  if (ArrayBuffer.isView(value) || Array.isArray(value))
    return Array.from(value, (part) => plain(part, type));
  if (value.identifierType !== undefined) return value.toString();
  if (value.schema?.name === "LocalizedText") return value.text;
  if (value.schema?.name === "QualifiedName") return value.name;
  const fields = value.schema?.fields ?? [];
  return Object.fromEntries(fields.map(({ name }) => [name, plain(value[name])]));
}

function variant({ type, value }) {
  return new Variant({
    dataType: DataType[type],
    value: type === "String" ? value : Number(value),
  });
}

// node-opcua knows "ns=" only; our ids name the namespace.
function id(session, text) {
  const match = /^nsu=([^;]+);(.*)$/s.exec(text);
  return match ? `ns=${session.getNamespaceIndex(match[1])};${match[2]}` : text;
}

function filter({ trigger = "StatusValue", deadband }) {
  return new DataChangeFilter({
    trigger: DataChangeTrigger[trigger === "StatusValueTimestamp" ? trigger : "StatusValue"],
    deadbandType: DeadbandType[deadband?.type ?? "None"],
    deadbandValue: deadband?.value ?? 0,
  });
}

async function monitor({ session, subscription, changes }, wanted, index) {
  const item = ClientMonitoredItem.create(
    subscription,
    { nodeId: id(session, wanted.node), attributeId: AttributeIds.Value },
    {
      samplingInterval: 0,
      queueSize: wanted.queue ?? 1000,
      discardOldest: true,
      filter: filter(wanted),
    },
    TimestampsToReturn.Both,
    MonitoringMode.Reporting,
  );
  item.on("changed", (dataValue) => changes[index].push(shown(dataValue)));
  return new Promise((resolve) => {
    item.on("initialized", () => {
      const { revisedQueueSize: queue, revisedSamplingInterval: sampling } = item.result;
      resolve({ code: 0, queue, sampling });
    });
    item.on("err", () => resolve({ code: item.statusCode.value }));
  });
}

const operations = {
  async connect(_, step) {
    const options = {
      applicationName: "valvemap-node-peer",
      endpointMustExist: false,
      keepSessionAlive: true,
      connectionStrategy: { maxRetry: 20, initialDelay: 100, maxDelay: 500 },
    };
    if (step.policy) {
      options.securityMode = MessageSecurityMode.SignAndEncrypt;
      options.securityPolicy = SecurityPolicy[step.policy];
      options.certificateFile = step.certificate;
      options.privateKeyFile = step.key;
      options.applicationUri = step.applicationUri;
      options.clientCertificateManager = new OPCUACertificateManager({
        rootFolder: step.pki,
        automaticallyAcceptUnknownCertificate: true,
      });
    }
    const client = OPCUAClient.create(options);
    await client.connect(step.url);
    try {
      const session = await client.createSession(
        step.user
          ? { type: UserTokenType.UserName, userName: step.user, password: step.password }
          : { type: UserTokenType.Anonymous },
      );
      await session.readNamespaceArray();
      connections.set(step.as, { client, session });
    } catch (error) {
      await client.disconnect();
      throw error;
    }
    return {};
  },

  async disconnect({ client, session }, step) {
    await session.close();
    await client.disconnect();
    connections.delete(step.as);
    return {};
  },

  async follow({ session }, { node, path }) {
    const elements = path.map(([uri, name]) => ({
      referenceTypeId: "i=33",
      includeSubtypes: true,
      targetName: { namespaceIndex: session.getNamespaceIndex(uri), name },
    }));
    const found = await session.translateBrowsePath({
      startingNode: id(session, node),
      relativePath: { elements },
    });
    const targets = (found.targets ?? []).map((target) => target.targetId.value);
    return { code: found.statusCode.value, targets };
  },

  async browse({ session }, { node, reference = "i=33", page = 0 }) {
    session.requestedMaxReferencesPerNode = page;
    let result = await session.browse({
      nodeId: id(session, node),
      referenceTypeId: reference,
      includeSubtypes: true,
      browseDirection: BrowseDirection.Forward,
      resultMask: 63,
    });
    const names = [];
    for (let pages = 1; ; pages += 1) {
      names.push(...(result.references ?? []).map((reference) => reference.browseName.name));
      if (!result.continuationPoint?.length)
        return { code: result.statusCode.value, names, pages };
      result = await session.browseNext(result.continuationPoint, false);
    }
  },

  async read({ session }, { node, attribute = "Value", range }) {
    return shown(
      await session.read({
        nodeId: id(session, node),
        attributeId: AttributeIds[attribute],
        indexRange: range,
      }),
    );
  },

  // All nodes that references lead to, and the methods of objects among them.
  async walk({ session }, { root, reference }) {
    const classes = new Map([[root, NodeClass.Object]]);
    const methods = [];
    for (let open = [root]; open.length; ) {
      const batch = open.splice(0, BROWSED_AT_ONCE);
      const results = await session.browse(
        batch.map((nodeId) => ({
          nodeId,
          referenceTypeId: reference,
          includeSubtypes: true,
          browseDirection: BrowseDirection.Forward,
          resultMask: 63,
        })),
      );
      for (const [at, result] of results.entries()) {
        if (result.continuationPoint?.length) throw new Error(`${batch[at]}: more than a page`);
        for (const { nodeId, nodeClass } of result.references ?? []) {
          const id = nodeId.toString();
          const isNew = !classes.has(id);
          if (nodeClass === NodeClass.Method && classes.get(batch[at]) === NodeClass.Object)
            methods.push([batch[at], id]);
          if (isNew) {
            classes.set(id, nodeClass);
            open.push(id);
          }
        }
      }
    }
    return { nodes: [...classes.keys()], methods };
  },

  // All attributes of each node in a request: how many have which status, which are refused, and
  // the DataTypes.
  async readEvery({ session }, { nodes, attributes }) {
    const codes = {};
    const faults = [];
    const types = {};
    for (const nodeId of nodes) {
      try {
        const found = await session.read(attributes.map((attributeId) => ({ nodeId, attributeId })));
        for (const [at, { statusCode, value }] of found.entries()) {
          codes[statusCode.value] = (codes[statusCode.value] ?? 0) + 1;
          if (attributes[at] === AttributeIds.DataType && statusCode.value === 0)
            types[nodeId] = value.value.toString();
        }
      } catch (error) {
        faults.push(`${nodeId}: ${error.message ?? error}`);
      }
    }
    return { codes, faults, types };
  },

  async write({ session }, { node, value }) {
    const code = await session.write({
      nodeId: id(session, node),
      attributeId: AttributeIds.Value,
      value: { value: variant(value) },
    });
    return { code: code.value };
  },

  async call({ session }, { owner, method, inputs }) {
    const result = await session.call({
      objectId: id(session, owner),
      methodId: id(session, method),
      inputArguments: inputs.map(variant),
    });
    return {
      code: result.statusCode.value,
      inputs: (result.inputArgumentResults ?? []).map((code) => code.value),
      outputs: (result.outputArguments ?? []).map((output) => plain(output.value)),
    };
  },

  async subscribe(connection, { items, interval }) {
    const subscription = await connection.session.createSubscription2({
      requestedPublishingInterval: interval,
      requestedLifetimeCount: 600,
      requestedMaxKeepAliveCount: 20,
      maxNotificationsPerPublish: 0,
      publishingEnabled: true,
      priority: 0,
    });
    Object.assign(connection, { subscription, changes: items.map(() => []) });
    const made = [];
    for (const [index, item] of items.entries()) made.push(await monitor(connection, item, index));
    return { interval: subscription.publishingInterval, items: made };
  },

  async changes(connection) {
    return connection.changes.map((taken) => taken.splice(0));
  },

  // Listens to events of a type, those derived from it too; fields by their names.
  async listen(connection, { node, fields, kind }) {
    const { session } = connection;
    connection.events = [];
    connection.listening = await session.createSubscription2({
      requestedPublishingInterval: 50,
      requestedLifetimeCount: 600,
      requestedMaxKeepAliveCount: 20,
      maxNotificationsPerPublish: 0,
      publishingEnabled: true,
      priority: 0,
    });
    const item = await connection.listening.monitor(
      { nodeId: node, attributeId: AttributeIds.EventNotifier },
      {
        samplingInterval: 0,
        queueSize: 1000,
        discardOldest: true,
        filter: constructEventFilter(fields, ofType(kind)),
      },
      TimestampsToReturn.Both,
      MonitoringMode.Reporting,
    );
    item.on("changed", (values) => {
      const told = values.map((each) => plain(each.value, DataType[each.dataType]));
      connection.events.push(Object.fromEntries(fields.map((name, at) => [name, told[at]])));
    });
    return { code: item.result.statusCode.value };
  },

  // Its own list of alarms: subscribes to conditions and asks for a refresh.
  async watchAlarms(connection) {
    connection.alarms = await installAlarmMonitoring(connection.session);
    return {};
  },

  async alarms({ alarms }) {
    return alarms.alarms().map((alarm) => ({
      name: alarm.fields.conditionName.value,
      source: alarm.fields.sourceName.value,
      text: alarm.fields.message.value.text,
      active: alarm.fields.activeState.id.value,
      acked: alarm.fields.ackedState.id.value,
      confirmed: alarm.fields.confirmedState.id.value,
      retain: alarm.getRetain(),
      comment: alarm.fields.comment.value?.text ?? null,
      condition: alarm.conditionId.toString(),
    }));
  },

  async act({ session, alarms }, { name, method, comment }) {
    const found = alarms.alarms().find(({ fields }) => fields.conditionName.value === name);
    const code = await callMethodCondition(
      session,
      method,
      found.conditionId,
      found.eventId,
      comment,
    );
    return { code: code.value };
  },

  // What a variable was from start to end, in ms; aggregates where one is named.
  async history({ session }, { node, start, end, page = 0, aggregate, interval }) {
    const span = { startTime: new Date(start), endTime: new Date(end) };
    const historyReadDetails = aggregate
      ? new ReadProcessedDetails({
          ...span,
          processingInterval: interval,
          aggregateType: [aggregate],
          aggregateConfiguration: { useServerCapabilitiesDefaults: true },
        })
      : new ReadRawModifiedDetails({ ...span, numValuesPerNode: page });
    const values = [];
    let continuationPoint = null;
    for (let pages = 1; ; pages += 1) {
      const request = new HistoryReadRequest({
        historyReadDetails,
        timestampsToReturn: TimestampsToReturn.Both,
        nodesToRead: [{ nodeId: id(session, node), continuationPoint }],
      });
      const [found] = (await session.historyRead(request)).results;
      values.push(...(found.historyData?.dataValues ?? []).map(shown));
      continuationPoint = found.continuationPoint;
      if (!continuationPoint?.length) return { code: found.statusCode.value, pages, values };
    }
  },

  async events({ events }) {
    return events.splice(0);
  },

  async unsubscribe({ subscription }) {
    await subscription.terminate();
    return {};
  },
};

function codeOf(error) {
  const name = /Bad[A-Z]\w+/.exec(String(error.message ?? error))?.[0];
  return error.response?.responseHeader?.serviceResult?.value ?? StatusCodes[name]?.value ?? null;
}

async function run() {
  for await (const line of createInterface({ input: process.stdin })) {
    const step = { as: "main", ...JSON.parse(line) };
    let answer;
    try {
      answer = { result: await operations[step.op](connections.get(step.as), step) };
    } catch (error) {
      answer = { error: String(error.message ?? error), code: codeOf(error) };
    }
    process.stdout.write(`${JSON.stringify(answer)}\n`);
  }
  process.exit(0);
}

run();
