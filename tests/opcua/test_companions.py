"""Valves by the names of companion specifications; what we have of these, beside the originals."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest
import pytest_asyncio
from asyncua import ua

from documentation.companions import KEPT, PARTS, NodeSet, cut
from support import ncc_peer, node_peer
from support.conditions import raised
from support.served import patient
from support.stream import until
from valvemap.config.names import RESERVED_ESTIMATORS
from valvemap.opcua_results.companions import DI, MACHINERY, PADIM, PROCESS
from valvemap.opcua_results.results_server import NAMESPACE
from valvemap.pipeline.device_health import DeviceHealth

HERE = Path(__file__).parent
STANDARD = "http://opcfoundation.org/UA/"
URIS = DI, MACHINERY, PADIM, PROCESS
FILES = {uri: KEPT / part.kept for uri, part in zip(URIS, PARTS, strict=True)}
IS_PART = "IsNamespaceSubset"
Ids = ua.ObjectIds
Codes = ua.StatusCodes
a_loop = pytest.mark.asyncio(loop_scope="module")


def kept(uri):
    return NodeSet(FILES[uri].read_text(encoding="utf-8"))


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def plant():
    async with raised() as plant:
        yield plant


@pytest_asyncio.fixture(loop_scope="module")
async def client(plant):
    async with patient(plant.server.url) as client:
        yield client


async def index(client, uri):
    return await client.get_namespace_index(uri)


async def found(client, *path):
    """The node that a path of namespaces and names leads to from Objects."""
    names = [ua.QualifiedName(name, await index(client, uri)) for uri, name in path]
    return await client.nodes.objects.get_child(names)


VALVE = (DI, "DeviceSet"), (NAMESPACE, "Valvistor")


@a_loop
async def test_no_estimator_may_take_the_name_of_a_valves_other_node(client):
    children = await (await found(client, *VALVE)).get_children()
    own = [str(child.nodeid.Identifier).split(".") for child in children]
    names = {part[1] for part in own if part[0] == "Valvistor" and len(part) > 1}
    assert names - set(RESERVED_ESTIMATORS) == {"RLS"}


@pytest.mark.parametrize("uri", URIS)
def test_a_part_needs_no_node_that_is_not_there(uri):
    every = {key for one in map(kept, URIS) for key in one.nodes}
    part = kept(uri)
    for key, node in part.nodes.items():
        assert key[0] == uri
        for needed in part.needs(node):
            assert needed[0] == STANDARD or needed in every, (key, needed)


@pytest.mark.parametrize("uri", URIS)
@a_loop
async def test_a_server_has_each_node_of_a_part_at_its_own_id(client, uri):
    part, at = kept(uri), await index(client, uri)
    ids = {key: ua.NodeId(int(key[1].removeprefix("i=")), at) for key in part.nodes}
    names = await client.uaclient.read_attributes(list(ids.values()), ua.AttributeIds.BrowseName)
    classes = await client.uaclient.read_attributes(list(ids.values()), ua.AttributeIds.NodeClass)
    uris = await client.get_namespace_array()
    for key, name, kind in zip(ids, names, classes, strict=True):
        node = part.nodes[key]
        shown = name.Value.Value
        assert (uris[shown.NamespaceIndex], shown.Name) == part.name(node)
        assert node.tag.endswith(f"UA{ua.NodeClass(kind.Value.Value).name}")
        said = await client.get_node(ids[key]).get_references()
        has = {
            (_key(uris, one.ReferenceTypeId), one.IsForward, _key(uris, one.NodeId)) for one in said
        }
        assert set(part.references(node)) <= has, key


def _key(uris, id_):
    return uris[id_.NamespaceIndex], f"i={id_.Identifier}"


@pytest.mark.parametrize(
    ("uri", "version"),
    [(DI, "1.04.0"), (MACHINERY, "1.04.0"), (PADIM, "1.01.0"), (PROCESS, "1.00.0")],
)
@a_loop
async def test_a_namespace_says_that_it_is_a_part_and_of_what(client, uri, version):
    at = await index(client, uri)
    namespaces = client.get_node(ua.NodeId(Ids.Server_Namespaces))
    own = await namespaces.get_child([ua.QualifiedName(uri, at)])
    assert await own.read_type_definition() == ua.NodeId(Ids.NamespaceMetadataType)
    assert await (await own.get_child(f"0:{IS_PART}")).read_value() is True
    assert await (await own.get_child("0:NamespaceUri")).read_value() == uri
    assert await (await own.get_child("0:NamespaceVersion")).read_value() == version
    (model,) = kept(uri).root.iter("{http://opcfoundation.org/UA/2011/03/UANodeSet.xsd}Model")
    published = await (await own.get_child("0:NamespacePublicationDate")).read_value()
    assert f"{published:%Y-%m-%d}" == model.get("PublicationDate")[:10]


@a_loop
async def test_a_valve_is_the_same_node_by_either_path(client):
    device = await found(client, *VALVE)
    at = await index(client, NAMESPACE)
    assert device.nodeid == ua.NodeId("Valvistor", at)
    back = await device.get_references(Ids.Organizes, ua.BrowseDirection.Inverse)
    assert await index(client, DI) in {one.NodeId.NamespaceIndex for one in back}
    devices = await (await found(client, VALVE[0])).get_children()
    assert [one.nodeid.Identifier for one in devices] == ["Valvistor"]


@a_loop
async def test_a_plate_says_what_is_known_and_what_should_be(client):
    plate = await found(client, *VALVE, (DI, "Identification"))
    kind = ua.NodeId(1005, await index(client, MACHINERY))
    assert await plate.read_type_definition() == kind
    (add_in,) = await plate.get_references(Ids.HasAddIn, ua.BrowseDirection.Inverse)
    assert add_in.NodeId.Identifier == "Valvistor"
    shown = {(await one.read_browse_name()).Name: one for one in await plate.get_properties()}
    held = {
        name: await one.read_data_value(raise_on_bad_status=False) for name, one in shown.items()
    }
    known = {"Manufacturer": "Muster AG", "Model": "V-100", "ComponentName": "Valvistor"}
    assert held.keys() == {*known, "SerialNumber"}  # which its type demands
    assert {name: held[name].Value.Value.Text for name in known} == known
    assert {held[name].StatusCode.value for name in known} == {Codes.Good}
    unknown = held["SerialNumber"]
    assert (unknown.Value.Value, unknown.StatusCode.value) == ("", Codes.UncertainInitialValue)


@a_loop
async def test_a_part_has_all_that_its_type_demands(client):
    kind = client.get_node(ua.NodeId(1004, await index(client, MACHINERY)))
    demanded = set()
    for part in await kind.get_properties():
        rules = await part.get_referenced_nodes(Ids.HasModellingRule)
        if ua.NodeId(Ids.ModellingRule_Mandatory) in [rule.nodeid for rule in rules]:
            demanded.add((await part.read_browse_name()).Name)
    plate = await found(client, *VALVE, (DI, "Identification"))
    has = {(await part.read_browse_name()).Name for part in await plate.get_properties()}
    assert demanded == {"Manufacturer", "SerialNumber"}
    assert demanded <= has


@a_loop
async def test_health_follows_the_alarms(client, plant):
    health = await found(client, *VALVE, (DI, "DeviceHealth"))
    at = await index(client, DI)
    assert health.nodeid.Identifier == "Valvistor.DeviceHealth"
    assert await health.read_data_type() == ua.NodeId(6244, at)
    device = await found(client, *VALVE)
    (interface,) = await device.get_referenced_nodes(Ids.HasInterface)
    assert interface.nodeid == ua.NodeId(15051, at)
    assert await health.read_value() == DeviceHealth.NORMAL
    await plant.set_lag(0.3)
    assert await health.read_value() == DeviceHealth.MAINTENANCE_REQUIRED
    await plant.lose_sensors()
    held = await health.read_data_value()
    assert held.Value.Value == DeviceHealth.FAILURE
    assert held.StatusCode.value == Codes.Good
    await plant.calm()
    assert await health.read_value() == DeviceHealth.NORMAL


@pytest.mark.parametrize(
    ("name", "original", "unit"),
    [
        ("U", "Signals.U", "%"),
        ("p1", "Signals.p1", "bar"),
        ("p2", "Signals.p2", "bar"),
        ("dp", "Signals.dp", "bar"),
        ("Q", "Signals.Q", "l/min"),
        ("T", "Signals.T", "°C"),
        ("FlowDemand", "Inverse.FlowDemand", "l/min"),
        ("PressureDrop", "Inverse.PressureDrop", "bar"),
        ("RequiredU", "Inverse.RequiredU", "%"),
    ],
)
@a_loop
async def test_a_signal_is_a_process_value_of_its_type(client, name, original, unit):
    own = await found(client, *VALVE, (NAMESPACE, "ProcessValues"), (NAMESPACE, name))
    assert own.nodeid.Identifier == f"Valvistor.ProcessValues.{name}"
    assert await own.read_type_definition() == ua.NodeId(1003, await index(client, PROCESS))
    padim = await index(client, PADIM)
    tag = await own.get_child(ua.QualifiedName("SignalTag", padim))
    assert await tag.read_value() == f"Valvistor.{original}"
    shown = await own.get_child(ua.QualifiedName("AnalogSignal", padim))
    assert shown.nodeid.Identifier == f"Valvistor.ProcessValues.{name}.AnalogSignal"
    assert await shown.read_type_definition() == ua.NodeId(1111, padim)
    assert await shown.get_access_level() == {ua.AccessLevel.CurrentRead}
    assert (
        await (await shown.get_child("0:EngineeringUnits")).read_value()
    ).DisplayName.Text == unit
    plain = client.get_node(ua.NodeId(f"Valvistor.{original}", own.nodeid.NamespaceIndex))
    both = [await (await one.get_child("0:EURange")).read_value() for one in (shown, plain)]
    assert both[0] == both[1]


def logged_in(plant):
    client = patient(plant.server.url)
    client.set_user("operator")
    client.set_password("correct horse")
    return client


class Heard:
    def __init__(self):
        self.values = {}

    def datachange_notification(self, node, _value, data):
        of = self.values.setdefault(str(node.nodeid.Identifier), [])
        held = data.monitored_item.Value
        of.append((held.Value.Value, held.StatusCode.value, held.SourceTimestamp))


@a_loop
async def test_a_process_value_changes_with_the_variable_that_it_shows(client, plant):
    at = await index(client, NAMESPACE)
    pairs = {
        "ProcessValues.Q.AnalogSignal": "Signals.Q",
        "ProcessValues.RequiredU.AnalogSignal": "Inverse.RequiredU",
        "ProcessValues.FlowDemand.AnalogSignal": "Inverse.FlowDemand",
    }
    heard = Heard()
    nodes = [ua.NodeId(f"Valvistor.{name}", at) for pair in pairs.items() for name in pair]
    subscription = await client.create_subscription(50, heard)
    every = ua.DataChangeFilter(ua.DataChangeTrigger.StatusValueTimestamp)
    followed = [client.get_node(node) for node in nodes]
    await subscription._subscribe(followed, ua.AttributeIds.Value, every)
    async with logged_in(plant) as operator:
        for count, demand in enumerate((30.0, 60.0), 1):
            await until(
                lambda count=count: len(heard.values.get("Valvistor.Signals.Q", ())) >= count
            )
            await operator.get_node(nodes[-1]).write_value(
                ua.Variant(demand, ua.VariantType.Double)
            )
            plant.clock.advance(1.0)  # scalars are due again
            await plant.calm()
    await until(lambda: len(heard.values["Valvistor.Signals.Q"]) >= 3)
    await subscription.delete()
    for shown, original in pairs.items():
        assert heard.values[f"Valvistor.{shown}"] == heard.values[f"Valvistor.{original}"]


@a_loop
async def test_nobody_writes_what_others_have_named(client, plant):
    async with logged_in(plant) as client_of:
        tag = client_of.get_node(ua.NodeId(6013, await index(client_of, MACHINERY)))
        assert await tag.get_access_level() == {ua.AccessLevel.CurrentRead}
        with pytest.raises(ua.uaerrors.BadNotWritable):
            await tag.write_value(ua.DataValue(ua.Variant("x")))


@pytest.fixture(scope="module")
def cache(request):
    return request.config.cache.mkdir("node_peer")


@pytest.fixture(scope="module")
def originals(cache):
    target = node_peer.installed(node_peer.FOLDER, cache)
    return target / "node_modules" / "node-opcua-nodesets" / "nodesets"


@pytest.mark.node
def test_what_is_kept_is_cut_out_of_the_originals(originals):
    for name, text in cut(originals).items():
        assert (KEPT / name).read_text(encoding="utf-8") == text, "run documentation.companions"


@pytest.mark.node
@pytest.mark.parametrize(("uri", "part"), list(zip(URIS, PARTS, strict=True)))
def test_each_node_is_what_it_is_in_the_original(originals, uri, part):
    whole = NodeSet((originals / part.original).read_text(encoding="utf-8"))
    ours = kept(uri)
    every = {key for one in map(kept, URIS) for key in one.nodes}
    assert "OPC Foundation MIT License" in ours.text
    for key, node in ours.nodes.items():
        other = whole.nodes[key]
        assert node.tag == other.tag
        assert ours.name(node) == whole.name(other)
        assert _identified(ours, node) == _identified(whole, other)
        stated = [
            one for one in whole.references(other) if one[2][0] == STANDARD or one[2] in every
        ]
        assert list(ours.references(node)) == stated
        for tag in ("DisplayName", "Description", "Definition", "Value"):
            if tag == "Value" and node.get("BrowseName") == IS_PART:
                continue
            assert _texts(node, tag) == _texts(other, tag), (key, tag)


def _identified(file, node):
    """A node's attributes, with keys in place of ids and names that have an index of the file."""
    ids = {"NodeId", "ParentNodeId", "DataType"} & node.attrib.keys()
    return node.attrib | {name: file.key(node.get(name)) for name in ids} | {"BrowseName": None}


def _texts(node, tag):
    found = node.find(f"{{http://opcfoundation.org/UA/2011/03/UANodeSet.xsd}}{tag}")
    return None if found is None else [(one.tag, (one.text or "").strip()) for one in found.iter()]


@pytest.mark.node
@pytest.mark.parametrize("uri", URIS)
def test_a_part_is_valid_by_the_schema(originals, uri):
    java = shutil.which("java")
    if java is None:
        pytest.skip("java is not installed")
    schema = originals / "UANodeSet.xsd"
    command = [java, HERE / "java_peer" / "Validate.java", schema, FILES[uri]]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr[-2_000:]


@pytest.mark.node
@pytest.mark.parametrize("uri", URIS)
def test_node_opcua_imports_a_part_and_finds_the_same(cache, uri):
    needed = list(FILES.values())[: URIS.index(uri) + 1]
    command = [*node_peer.program(cache, "nodeset.cjs"), uri, *needed]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr[-2_000:]
    shown = {f"i={one['id']}": one for one in json.loads(done.stdout.splitlines()[-1])}
    part = kept(uri)
    assert shown.keys() == {id_ for _, id_ in part.nodes}
    for (_, id_), node in part.nodes.items():
        assert shown[id_]["name"] == part.name(node)[1]
        assert node.tag.endswith(f"UA{shown[id_]['class']}")


@pytest.mark.compiler
@pytest.mark.timeout(900)  # half a minute, on a machine that is not busy
def test_open62541_imports_both_and_finds_the_same(request, tmp_path):
    pytest.importorskip("o6")
    compiler = ncc_peer.installed(request.config.cache)
    every = json.loads(ncc_peer.said(compiler, "companions.py", tmp_path, *FILES.values()))
    for uri in URIS:
        part = kept(uri)
        names = {id_: part.name(node)[1] for (_, id_), node in part.nodes.items()}
        assert {f"i={id_}": name for id_, (_, name) in every[uri].items()} == names
