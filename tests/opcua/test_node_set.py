"""The types of the results server: valid and importable as XML, and the instances' own."""

import json
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import pytest_asyncio
from asyncua import ua

from documentation.node_set import rig_node_set, written
from documentation.pages import NODE_SET, RIG_NODE_SET
from support import ncc_peer, node_peer
from support.conditions import raised
from support.served import patient
from valvemap.opcua_results.namespaces import RIG_NAMESPACE
from valvemap.opcua_results.result_types import ENUMERATIONS
from valvemap.opcua_results.results_server import NAMESPACE

HERE = Path(__file__).parent
NODES = "{http://opcfoundation.org/UA/2011/03/UANodeSet.xsd}"
Ids = ua.ObjectIds
a_loop = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def plant():
    async with raised() as plant:
        yield plant


@pytest_asyncio.fixture(loop_scope="module")
async def client(plant):
    async with patient(plant.server.url) as client:
        yield client


def declared_in(file):
    """Every node of a file: its element by its id."""
    root = ET.fromstring(file.read_text(encoding="utf-8"))  # noqa: S314 - our own file
    return {node.get("NodeId"): node for node in root if node.get("NodeId")}


@pytest.fixture(scope="module")
def declared():
    return declared_in(NODE_SET)


ENUM_STRINGS = tuple(f"Types.{kind.__name__}.EnumStrings" for kind in ENUMERATIONS)


def has_rule(element, id_):
    """Whether a node of the file is a part of a type of objects."""
    is_a_type = element.tag[len(NODES) :] in ("UAObjectType", "UADataType")
    return not is_a_type and not id_.endswith(ENUM_STRINGS)


both_files = pytest.mark.parametrize(
    ("file", "uri"),
    [(NODE_SET, NAMESPACE), (RIG_NODE_SET, RIG_NAMESPACE)],
    ids=["service", "rig"],
)


@a_loop
async def test_the_file_is_what_a_running_server_has(plant):
    inside = plant.server._server
    made = written(inside.address_space, inside.namespace_index, NAMESPACE)
    kept = NODE_SET.read_text(encoding="utf-8")
    assert made == kept, "run `make reference`, and look at what has changed"


def test_the_rigs_file_is_what_a_rig_has():
    kept = RIG_NODE_SET.read_text(encoding="utf-8")
    assert rig_node_set() == kept, "run `make reference`, and look at what has changed"


@a_loop
async def test_a_client_finds_each_node_of_the_file_under_its_id_and_name(client, declared):
    index = await client.get_namespace_index(NAMESPACE)
    wanted = [
        ua.NodeId(id_.removeprefix("ns=1;s="), index) for id_ in declared if id_.startswith("ns=1;")
    ]
    assert len(wanted) == len(declared) > 150
    names = await client.uaclient.read_attributes(wanted, ua.AttributeIds.BrowseName)
    for held, element in zip(names, declared.values(), strict=True):
        name = held.Value.Value
        prefix = "1:" if name.NamespaceIndex == index else ""
        assert f"{prefix}{name.Name}" == element.get("BrowseName")


@pytest.mark.parametrize(
    ("instance", "kind"),
    [
        ("Valvistor", "ValveType"),
        ("Valvistor.RLS", "EstimatorType"),
        ("Valvistor.Inverse", "InverseMapType"),
        ("Valvistor.Signals", "SignalsType"),
        ("Valvistor.Baseline", "BaselineType"),
        ("Valvistor.Diagnostics", "DiagnosticsType"),
        ("Valvistor.Alarms.Residual", "AlarmType"),
        ("Service.Alarms.Load", "AlarmType"),
    ],
)
@a_loop
async def test_an_instance_has_all_that_its_type_demands(client, instance, kind):
    index = await client.get_namespace_index(NAMESPACE)
    own = client.get_node(ua.NodeId(instance, index))
    of = client.get_node(await own.read_type_definition())
    assert (await of.read_browse_name()).Name == kind
    has = {(await part.read_browse_name()).Name: part for part in await own.get_children()}
    demanded, allowed = {}, set()
    for part in await of.get_children(refs=Ids.Aggregates):
        (rule,) = await part.get_referenced_nodes(Ids.HasModellingRule)
        name = (await part.read_browse_name()).Name
        allowed.add(name)
        if rule.nodeid == ua.NodeId(Ids.ModellingRule_Mandatory):
            demanded[name] = part
    assert set(demanded) <= set(has)
    if kind != "ValveType":  # its estimators are placeholders there
        assert set(has) <= allowed
    for name, part in demanded.items():
        for attribute in (ua.AttributeIds.NodeClass, ua.AttributeIds.DataType):
            there = await part.read_attribute(attribute, raise_on_bad_status=False)
            here = await has[name].read_attribute(attribute, raise_on_bad_status=False)
            assert here.Value == there.Value, name
        if await part.read_node_class() == ua.NodeClass.Variable:
            mine = await has[name].read_type_definition()
            assert mine == await part.read_type_definition(), name


@a_loop
async def test_every_code_is_of_an_enumeration_with_its_names_and_sentences(client):
    index = await client.get_namespace_index(NAMESPACE)
    kinds = {ua.NodeId(f"Types.{kind.__name__}", index): kind for kind in ENUMERATIONS}
    for id_, kind in kinds.items():
        node = client.get_node(id_)
        assert [base.nodeid for base in await node.get_referenced_nodes(
            Ids.HasSubtype, ua.BrowseDirection.Inverse
        )] == [ua.NodeId(Ids.Enumeration)]  # fmt: skip
        definition = (await node.read_attribute(ua.AttributeIds.DataTypeDefinition)).Value.Value
        assert [(f.Value, f.Name, f.Description.Text) for f in definition.Fields] == [
            (member.value, member.name, member.sentence) for member in kind
        ]
    waiting, bare, typed = [client.get_node(ua.NodeId("Identification", index))], [], set()
    while waiting:
        for part in await waiting.pop().get_children():
            if await part.read_node_class() == ua.NodeClass.Object:
                waiting.append(part)
            names = {(await one.read_browse_name()).Name for one in await part.get_properties()}
            if "EnumStrings" not in names or part.nodeid.NamespaceIndex != index:
                continue
            data_type = await part.read_data_type()
            typed.add(data_type)
            if data_type == ua.NodeId(Ids.Int32):
                bare.append(part.nodeid.Identifier)
    assert not bare
    assert len(typed & kinds.keys()) >= 5


@a_loop
async def test_the_namespace_says_what_it_is(client):
    index = await client.get_namespace_index(NAMESPACE)
    namespaces = client.get_node(ua.NodeId(Ids.Server_Namespaces))
    own = await namespaces.get_child(f"{index}:{NAMESPACE}")
    assert await own.read_type_definition() == ua.NodeId(Ids.NamespaceMetadataType)
    assert await (await own.get_child("0:NamespaceUri")).read_value() == NAMESPACE
    assert await (await own.get_child("0:StaticNodeIdTypes")).read_value() == [1]
    assert await (await own.get_child("0:IsNamespaceSubset")).read_value() is False


@a_loop
async def test_roles_are_shown_without_methods_that_would_do_nothing(client):
    roles = client.get_node(ua.NodeId(Ids.Server_ServerCapabilities_RoleSet))
    open_, methods = [roles], []
    while open_:
        node = open_.pop()
        open_ += await node.get_children(nodeclassmask=ua.NodeClass.Object)
        methods += await node.get_children(nodeclassmask=ua.NodeClass.Method)
    assert methods == []
    assert len(await roles.get_children()) >= 5


@pytest.fixture(scope="module")
def packages(request):
    cache = request.config.cache.mkdir("node_peer")
    return node_peer.installed(node_peer.FOLDER, cache), cache


@pytest.mark.node
@both_files
def test_node_opcua_imports_it_and_finds_the_same(packages, file, uri):
    _, cache = packages
    declared = declared_in(file)
    command = [*node_peer.program(cache, "nodeset.cjs"), uri, file]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr[-2_000:]
    found = {f"ns=1;s={node['id']}": node for node in json.loads(done.stdout.splitlines()[-1])}
    assert found.keys() == declared.keys()
    for id_, node in found.items():
        element = declared[id_]
        assert node["name"] == element.get("BrowseName").rpartition(":")[2]
        assert element.tag == f"{NODES}UA{node['class']}"
        if element.get("ParentNodeId"):
            assert node["parent"] == element.get("ParentNodeId").removeprefix("ns=1;s=")
        assert (node["rule"] is not None) == has_rule(element, id_)
    if file == RIG_NODE_SET:
        assert found["ns=1;s=Types.RigValve.Q"]["unit"] == "l/min"
        return
    assert found["ns=1;s=Types.Valve.Inverse"]["type"] == "InverseMapType"
    assert found["ns=1;s=Types.Signals.Q"]["unit"] == "l/min"
    assert found["ns=1;s=Types.Inverse.Invert"]["inputs"] == ["Q", "dp", "T"]
    assert found["ns=1;s=Types.Estimator.ChangeCount"]["rule"] == "Optional"


@pytest.fixture(scope="module")
def compiler(request):
    """Where open62541's NodeSet compiler is installed."""
    return ncc_peer.installed(request.config.cache)


@pytest.mark.compiler
@pytest.mark.timeout(900)  # half a minute, on a machine that is not busy
@both_files
def test_open62541_imports_it_and_finds_the_same(compiler, file, uri, tmp_path):
    pytest.importorskip("o6")
    declared = declared_in(file)
    flow = "Types.Signals.Q" if file == NODE_SET else "Types.RigValve.Q"
    said = json.loads(ncc_peer.said(compiler, "imported.py", file, uri, flow, tmp_path))
    found = {f"ns=1;s={node['id']}": node for node in said["nodes"]}
    assert found.keys() == declared.keys()
    for id_, node in found.items():
        element = declared[id_]
        assert node["name"] == element.get("BrowseName").rpartition(":")[2]
        assert element.tag == f"{NODES}UA{node['class']}"
        if element.get("ParentNodeId"):
            assert node["parent"] == element.get("ParentNodeId").removeprefix("ns=1;s=")
        if id_.count(".") < 3:  # the compiler passes over those of properties
            assert (node["rule"] is not None) == has_rule(element, id_)
    assert said["unit"] == "l/min"


@pytest.mark.node
@both_files
def test_it_is_valid_by_the_schema(packages, file, uri):
    target, _ = packages
    java = shutil.which("java")
    if java is None:
        pytest.skip("java is not installed")
    schema = target / "node_modules" / "node-opcua-nodesets" / "nodesets" / "UANodeSet.xsd"
    command = [java, HERE / "java_peer" / "Validate.java", schema, file]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr[-2_000:]
