"""Members of structures are signals: read, browsed, named if they are not there, never guessed."""

import asyncio
import struct
from contextlib import asynccontextmanager
from dataclasses import replace
from math import isnan

import pytest
from asyncua import Server, ua

from support.proxy import Proxy
from support.received import until
from valvemap.errors import ConfigurationError, SourceLost, SourceRejected
from valvemap.opcua_client.connection import open_connection
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_source.browsing import find_numbers
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.members import Member, encodings_of, numbers_in, taken
from valvemap.opcua_source.source_nodes import ValveNodes
from valvemap.opcua_source.structures import (
    DEEPEST,
    Field,
    Form,
    Structure,
    kind_of,
    parse_path,
    path_text,
)
from valvemap.opcua_source.wire import DecodeError

DOUBLE, STRING, INT16, BOOLEAN = 11, 12, 4, 1
VALVE = "nsu=urn:plant;s=Valve"
SECOND = "nsu=urn:plant;s=Second"
NODES = ValveNodes(
    "V1",
    f"member=Command;{VALVE}",
    f"member=Pressures[0].Value;{VALVE}",
    f"member=Pressures[1].Value;{VALVE}",
    f"member=Flow.Value;{VALVE}",
)
SIGNAL = Structure("Signal", (Field("Name", STRING), Field("Value", DOUBLE)))
OF_VALVE = Structure(
    "Valve",
    (
        Field("Command", INT16),
        Field("Pressures", 22, 1, SIGNAL),
        Field("Flow", 22, 0, SIGNAL),
        Field("Open", BOOLEAN),
    ),
)


def signal(name, value):
    return struct.pack("<i", len(name)) + name.encode() + struct.pack("<d", value)


def body(U=62, p=(170.5, 40.25), Q=30.0):
    pressures = b"".join(signal(f"p{n}", one) for n, one in enumerate(p))
    return struct.pack("<hi", U, len(p)) + pressures + signal("flow meter", Q) + b"\1"


def variant(own, encoding=b"\x01\x02\x07\x00"):
    return b"\x16" + encoding + b"\x01" + struct.pack("<i", len(own)) + own


def member(path, structure=OF_VALVE):
    place = parse_path(path)
    return Member(place, kind_of(structure, place), frozenset(encodings_of(2, 7)), structure)


@pytest.mark.parametrize(
    ("path", "kind", "value"),
    [
        ("Command", INT16, 62.0),
        ("Pressures[0].Value", DOUBLE, 170.5),
        ("Pressures[1].Value", DOUBLE, 40.25),
        ("Flow.Value", DOUBLE, 30.0),
        ("Open", BOOLEAN, 1.0),
    ],
)
def test_a_member_is_found_behind_strings_and_arrays(path, kind, value):
    assert path_text(parse_path(path)) == path
    assert taken(variant(body()), 0, member(path)) == (kind, value)


def test_what_does_not_fit_the_type_gives_no_number_instead_of_another_one():
    own = member("Flow.Value")
    assert taken(variant(body() + b"\0"), 0, own) is None  # a field more than the type has
    assert taken(variant(body()[:-1]), 0, own) is None
    assert taken(variant(body(), b"\x01\x02\x08\x00"), 0, own) is None  # another structure
    assert taken(variant(body(), b"\x02\x02\x00\x07\x00\x00\x00"), 0, own) == (DOUBLE, 30.0)
    assert taken(b"\x0b" + struct.pack("<d", 1.0), 0, own) is None
    kind, value = taken(variant(body(p=(1.0,))), 0, member("Pressures[1].Value"))
    assert kind == 0  # the array is shorter now: no value
    assert isnan(value)


def test_optional_members_and_unions_have_a_value_only_if_they_are_there():
    optional = Structure(
        "O",
        (Field("a", DOUBLE, optional=True), Field("b", DOUBLE), Field("c", DOUBLE, optional=True)),
        Form.OPTIONAL,
    )
    sent = variant(struct.pack("<Idd", 2, 1.5, 2.5))
    assert [taken(sent, 0, member(one, optional))[0] for one in "abc"] == [0, DOUBLE, DOUBLE]
    assert taken(sent, 0, member("c", optional)) == (DOUBLE, 2.5)
    union = Structure("U", (Field("a", DOUBLE), Field("b", INT16)), Form.UNION)
    sent = variant(struct.pack("<Ih", 2, 7))
    assert taken(sent, 0, member("b", union)) == (INT16, 7.0)
    assert taken(sent, 0, member("a", union))[0] == 0
    assert taken(variant(struct.pack("<I", 3)), 0, member("a", union)) is None


def test_a_hostile_value_costs_little_and_gives_no_number():
    many = Structure("M", (Field("s", STRING, 1), Field("x", DOUBLE)))
    sent = struct.pack("<i", 1_000_000) + b"\xff" * 4_000_000 + struct.pack("<d", 1.0)
    assert taken(variant(sent), 0, member("x", many)) is None
    endless = struct.pack("<i", 2**31 - 1)
    assert taken(variant(endless), 0, member("x", many)) is None
    nothing = Structure("N", ())
    empty = Structure("E", (Field("n", 22, 1, nothing), Field("x", DOUBLE)))
    assert taken(variant(endless + struct.pack("<d", 3.0)), 0, member("x", empty)) == (DOUBLE, 3.0)
    huge = Structure("H", (Field("m", DOUBLE, 3), Field("x", DOUBLE)))
    dimensions = struct.pack("<iIII", 3, 2**31, 2**31, 2**31)
    assert taken(variant(dimensions), 0, member("x", huge)) is None
    wide = SIGNAL
    for _ in range(DEEPEST - 1):  # 10^15 members
        wide = Structure("W", tuple(Field(f"f{n}", 22, 0, wide) for n in range(10)))
    with pytest.raises(DecodeError):
        numbers_in(wide, bytes(1_000_000), 64, 1_000)


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("Volume", "has no member 'Volume'; there are Command, Pressures, Flow, Open"),
        ("Flow.Mean", "has no member 'Flow.Mean'; there are Name, Value"),
        ("Flow", "has a structure at 'Flow'; its members are Name, Value"),
        ("Pressures.Value", "has an array at 'Pressures'; it needs an index such as [0]"),
        ("Flow[0].Value", "has no array at 'Flow'; leave out [0]"),
        ("Flow.Name", "has no number at 'Flow.Name'"),
        ("Command.Value", "has no structure at 'Command' whose members are known"),
    ],
)
def test_a_wrong_path_names_what_is_there(path, words):
    assert kind_of(OF_VALVE, parse_path(path)) == words


def test_a_member_is_no_command_and_its_path_has_a_form():
    with pytest.raises(ConfigurationError, match="a member is not written"):
        replace(NODES, required_U=f"member=Command;{VALVE}")
    for wrong in ("member=a..b;s=V", "member=;s=V", "member=a[x];s=V"):
        with pytest.raises(ConfigurationError, match="member=<name>"):
            replace(NODES, Q=wrong)


async def add_type(server, index, name, fields, base=ua.ObjectIds.Structure):
    """A structure and its encoding, as another stack would show them."""
    node = await server.get_node(ua.NodeId(base)).add_data_type(
        ua.NodeId(f"{name}.type", index), name
    )
    encoding = ua.NodeId(f"{name}.binary", index)
    object_ = await node.add_object(encoding, ua.QualifiedName("Default Binary", 0))
    await node.delete_reference(object_.nodeid, ua.ObjectIds.HasComponent)
    await node.add_reference(object_.nodeid, ua.ObjectIds.HasEncoding)
    definition = ua.StructureDefinition(
        DefaultEncodingId=encoding,
        BaseDataType=ua.NodeId(base),
        StructureType=ua.StructureType.Structure,
        Fields=[ua.StructureField(Name=n, DataType=t, ValueRank=r) for n, t, r in fields],
    )
    await node.write_data_type_definition(definition)
    return node.nodeid, encoding


@asynccontextmanager
async def structured():
    """A server with a valve's structure, an array of two, and types that are hostile."""
    server = Server()
    await server.init()
    server.set_endpoint("opc.tcp://127.0.0.1:0/plant/")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    index = await server.register_namespace("urn:plant")
    one, _ = await add_type(
        server, index, "Signal", [("Name", ua.NodeId(12), -1), ("Value", ua.NodeId(11), -1)]
    )
    valve, encoding = await add_type(
        server,
        index,
        "Valve",
        [
            ("Command", ua.NodeId(4), -1),
            ("Pressures", one, 1),
            ("Flow", one, -1),
            ("Open", ua.NodeId(1), -1),
        ],
    )
    inner = one
    for level in range(DEEPEST + 1):
        inner, deep = await add_type(server, index, f"Deep{level}", [("x", inner, -1)])
    loop = ua.NodeId("Loop.type", index)
    _, of_loop = await add_type(server, index, "Loop", [("x", loop, -1), ("y", ua.NodeId(11), -1)])
    values = {
        "Valve": (ua.ExtensionObject(encoding, body()), valve),
        "Deep": (ua.ExtensionObject(deep, bytes(99)), inner),
        "Loop": (ua.ExtensionObject(of_loop, bytes(99)), loop),
        "Strange": (ua.ExtensionObject(ua.NodeId("x", index), bytes(9)), ua.NodeId(22)),
    }
    nodes = {}
    for name, (value, of_type) in values.items():
        nodes[name] = await server.nodes.objects.add_variable(
            ua.NodeId(name, index), name, ua.Variant(value), datatype=of_type
        )
    two = [ua.ExtensionObject(encoding, body(U=n)) for n in (10, 20)]
    await server.nodes.objects.add_variable(
        ua.NodeId("Second", index), "Valves", ua.Variant(two), datatype=valve
    )
    async with server:
        port = server.bserver._server.sockets[0].getsockname()[1]
        nodes |= {"encoding": encoding, "type": server.get_node(valve)}
        yield f"opc.tcp://127.0.0.1:{port}/plant/", nodes


@pytest.mark.waits
async def test_members_are_browsed_read_and_named_if_they_are_not_there():
    async with structured() as (url, nodes):
        settings = SourceSettings(url, publishing_interval_ms=50.0)
        connection = await open_connection(settings)
        numbers, skipped = await find_numbers(connection)
        await connection.close()
        own = {"/".join(one.path): one.node for one in numbers}
        assert own == {
            "Valve/Command": f"member=Command;{VALVE}",
            "Valve/Pressures[0]/Value": f"member=Pressures[0].Value;{VALVE}",
            "Valve/Pressures[1]/Value": f"member=Pressures[1].Value;{VALVE}",
            "Valve/Flow/Value": f"member=Flow.Value;{VALVE}",
        } | {
            f"Valves[{n}]/{shown}": f"member=[{n}].{text};{SECOND}"
            for n in range(2)
            for shown, text in (
                ("Command", "Command"),
                ("Pressures[0]/Value", "Pressures[0].Value"),
                ("Pressures[1]/Value", "Pressures[1].Value"),
                ("Flow/Value", "Flow.Value"),
            )
        }
        assert next(one.largest for one in numbers if "Command" in one.path) == 32_767.0
        for name, words in (("Deep", "16 levels"), ("Loop", "16 levels"), ("Strange", "nothing")):
            assert any(line.startswith(name) and words in line for line in skipped)

        second = replace(NODES, valve="V2", U=f"member=[1].Command;{SECOND}")
        source = OpcUaSource(settings, [NODES, second])
        await source.connect()
        assert len({item.number for item in source._subscription.watched.items}) == 2
        wanted = {0: 62.0, 1: 170.5, 2: 40.25, 3: 30.0, 6: 20.0, 7: 170.5}
        await until(source, wanted)
        later = ua.ExtensionObject(nodes["encoding"], body(U=7, Q=31.5))
        await nodes["Valve"].write_value(ua.Variant(later))
        await until(source, {0: 7.0, 3: 31.5, 9: 31.5})
        assert source.counters.undecodable == 0
        items = source._subscription.watched.items
        await source._subscription.watched.monitor_again(items[0].node)
        again = ua.ExtensionObject(nodes["encoding"], body(U=8))
        await nodes["Valve"].write_value(ua.Variant(again))
        await until(source, {0: 8.0, 1: 170.5})
        await source.close()

        for wrong, words in (
            ({"U": f"member=Volume;{VALVE}"}, "has no member 'Volume'; there are Command"),
            ({"U": VALVE}, "is of type ExtensionObject .* member=<name>; before the NodeId"),
            ({"U": f"member=x.y;{VALVE.replace('Valve', 'Deep')}"}, "more than 16 levels deep"),
            ({"U": f"member=y;{VALVE.replace('Valve', 'Loop')}"}, "more than 16 levels deep"),
            ({"U": f"member=y;{VALVE.replace('Valve', 'Strange')}"}, "nothing describes"),
        ):
            with pytest.raises(SourceRejected, match=words) as error:
                await OpcUaSource(settings, [replace(NODES, **wrong)]).connect()
            assert "U of valve V1" in str(error.value)


@pytest.mark.waits
async def test_definitions_are_read_again_after_a_cut():
    async with structured() as (url, nodes), Proxy(int(url.split(":")[2].split("/")[0])) as proxy:
        own = url.replace(url.split(":")[2].split("/")[0], str(proxy.port))
        source = OpcUaSource(SourceSettings(own, publishing_interval_ms=50.0), [NODES])
        await source.connect()
        await until(source, {0: 62.0, 3: 30.0})
        proxy.cut()
        definition = await nodes["type"].read_data_type_definition()
        definition.Fields = definition.Fields[1:3] + definition.Fields[:1] + definition.Fields[3:]
        await nodes["type"].write_data_type_definition(definition)
        with pytest.raises(SourceLost):
            await until(source, {0: -1.0})
        await source.connect()
        for Q in range(40):  # the next look at the nodes comes within a second
            sent = body(Q=float(Q))
            other = sent[2:-1] + sent[:2] + sent[-1:]
            value = ua.ExtensionObject(nodes["encoding"], other)
            await nodes["Valve"].write_value(ua.Variant(value))
            await asyncio.sleep(0.05)
        await until(source, {0: 62.0, 3: 39.0})
        await source.close()
