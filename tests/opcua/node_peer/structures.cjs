// node-opcua as a plant whose valve is one variable: a structure with a string, an array of
// structures and an optional member before the signals; its type by a NodeSet, without security.
const { writeFileSync } = require("node:fs");
const { join } = require("node:path");
const { DataType, MessageSecurityMode, SecurityPolicy, StatusCodes, Variant } = require("node-opcua-client");
const { nodesets } = require("node-opcua-nodesets");
const { OPCUAServer } = require("node-opcua-server");

const PERIOD_MS = 20;
const port = Number(process.argv[2]);
const own = join(__dirname, `${process.pid}.NodeSet2.xml`);

const type = (id, name, fields, options = "") => `
  <UADataType NodeId="ns=1;i=${id}" BrowseName="1:${name}">
    <DisplayName>${name}</DisplayName>
    <References>
      <Reference ReferenceType="HasSubtype" IsForward="false">i=22</Reference>
      <Reference ReferenceType="HasEncoding">ns=1;i=${id + 1000}</Reference>
    </References>
    <Definition Name="1:${name}" ${options}>${fields
      .map(([field, dataType, more = ""]) => `<Field Name="${field}" DataType="${dataType}" ${more}/>`)
      .join("")}</Definition>
  </UADataType>
  <UAObject NodeId="ns=1;i=${id + 1000}" BrowseName="Default Binary" SymbolicName="DefaultBinary">
    <DisplayName>Default Binary</DisplayName>
    <References>
      <Reference ReferenceType="HasEncoding" IsForward="false">ns=1;i=${id}</Reference>
      <Reference ReferenceType="HasTypeDefinition">i=76</Reference>
    </References>
  </UAObject>`;
writeFileSync(
  own,
  `<?xml version="1.0" encoding="utf-8"?>
<UANodeSet xmlns="http://opcfoundation.org/UA/2011/03/UANodeSet.xsd">
  <NamespaceUris><Uri>urn:plc</Uri></NamespaceUris>
  <Models><Model ModelUri="urn:plc" Version="1.0" PublicationDate="2026-01-01T00:00:00Z"/></Models>
  ${type(3001, "GaugeType", [["Tag", "i=12"], ["Value", "i=11"]])}
  ${type(3002, "ValveType", [
    ["Name", "i=12"],
    ["Comment", "i=21", 'IsOptional="true"'],
    ["Command", "i=290"],
    ["Pressure", "ns=1;i=3001", 'ValueRank="1" ArrayDimensions="0"'],
    ["Flow", "ns=1;i=3001"],
    ["Count", "i=7"],
  ])}
</UANodeSet>`,
);

async function run() {
  const server = new OPCUAServer({
    port,
    host: "127.0.0.1",
    hostname: "127.0.0.1",
    resourcePath: "/plc/",
    nodeset_filename: [nodesets.standard, own],
    securityModes: [MessageSecurityMode.None],
    securityPolicies: [SecurityPolicy.None],
  });
  await server.initialize();
  const addressSpace = server.engine.addressSpace;
  const index = addressSpace.getNamespaceIndex("urn:plc");
  const namespace = addressSpace.getNamespace("urn:plc");
  const valveType = addressSpace.findDataType("ValveType", index);
  let k = 0;
  const Structure = addressSpace.getExtensionObjectConstructor(valveType);
  const next = () => {
    const U = 50 + 35 * Math.sin(0.031 * k) + 10 * Math.sin(0.083 * k);
    const load = 60 + 30 * Math.sin(0.0173 * k + 1);
    k += 1;
    return new Structure({
      name: `Y${k % 13}`,
      comment: k % 2 ? { text: "a comment", locale: "en" } : undefined,
      command: U,
      pressure: [
        { tag: "inlet", value: 200 },
        { tag: "outlet", value: load },
      ],
      flow: { tag: "gear", value: 0.05 * U * Math.sqrt(200 - load) },
      count: k,
    });
  };
  const variable = namespace.addVariable({
    browseName: "Valve",
    nodeId: "s=Valve",
    organizedBy: addressSpace.rootFolder.objects,
    dataType: valveType.nodeId,
    minimumSamplingInterval: PERIOD_MS, // it polls: a new structure is no event to it
    value: new Variant({ dataType: DataType.ExtensionObject, value: next() }),
  });
  const step = () =>
    variable.setValueFromSource(
      new Variant({ dataType: DataType.ExtensionObject, value: next() }),
      StatusCodes.Good,
      new Date(),
    );
  await server.start();
  setInterval(step, PERIOD_MS);
  process.stdout.write("ready\n");
  process.stdin.on("end", () => server.shutdown(0).then(() => process.exit(0)));
  process.stdin.resume();
}

run();
