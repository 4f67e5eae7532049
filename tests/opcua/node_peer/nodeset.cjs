// Imports UANodeSets into node-opcua and says what came of the last one's namespace: id, name, class,
// type, rule, parent.
const { AddressSpace } = require("node-opcua-address-space");
const { generateAddressSpace } = require("node-opcua-address-space/nodeJS");
const { NodeClass } = require("node-opcua-data-model");
const { nodesets } = require("node-opcua-nodesets");

const [uri, ...files] = process.argv.slice(2);

async function run() {
  const space = AddressSpace.create();
  await generateAddressSpace(space, [nodesets.standard, ...files]);
  const own = space.getNamespace(uri);
  const shown = [...own.nodeIterator()].map((node) => ({
    id: node.nodeId.value,
    name: node.browseName.name,
    class: NodeClass[node.nodeClass],
    type: node.typeDefinitionObj?.browseName.name ?? null,
    rule: node.modellingRule ?? null,
    parent: node.parentNodeId?.value ?? null,
    inputs: node.inputArguments?.readValue?.().value.value?.map(({ name }) => name) ?? null,
    unit: node.engineeringUnits?.readValue().value.value?.displayName?.text ?? null,
  }));
  process.stdout.write(`\n${JSON.stringify(shown)}`); // the last line: it says more before
  space.dispose();
  process.exit(0);
}

run();
