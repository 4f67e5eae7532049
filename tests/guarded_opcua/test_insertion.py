"""Nodes put straight into the address space are those that asyncua would have made."""

import pytest
from asyncua import ua
from asyncua.common.node import Node

from guarded_opcua import (
    HardenedServer,
    ManualClock,
    Role,
    ServerSettings,
    Unit,
    add_object,
)
from guarded_opcua.address_space import nodes as nodes_module
from guarded_opcua.address_space.nodes import Argument, add_method, add_variable
from guarded_opcua.errors import ServerError

pytestmark = pytest.mark.asyncio


async def server(clock=None):
    return await HardenedServer.create(
        ServerSettings(
            url="opc.tcp://127.0.0.1:0/",
            application_uri="urn:test:nodes",
            application_name="nodes",
            namespace_uri="urn:test",
            none_on_loopback=True,
        ),
        clock,
    )


async def filled(made):
    parent = await add_object(made, None, "Thing", description="A thing")
    await add_object(made, parent, "Thing.Part")
    await add_variable(made, parent, "Thing.x", 1.0, unit=Unit.BAR, value_range=(0.0, 2.0))
    await add_variable(made, parent, "Thing.s", 0, type=ua.VariantType.Int32, enum_strings=["a"])
    await add_variable(
        made, parent, "Thing.m", [1.0, 2.0], dimensions=(2,), writable_by=Role.OPERATOR
    )
    await add_method(
        made,
        parent,
        "Thing.Do",
        print,
        inputs=[Argument("a")],
        outputs=[Argument("b", array=True)],
        required=Role.OPERATOR,
    )
    return made


def described(made):
    space = made.address_space
    found = {}
    for id_ in list(space.keys()):
        if id_.NamespaceIndex == made.namespace_index or id_ == ua.NodeId(
            ua.ObjectIds.ObjectsFolder
        ):
            data = space[id_]
            attributes = {
                attribute: (held.value.Value, held.value.StatusCode)
                for attribute, held in data.attributes.items()
                if held.value is not None
            }
            found[id_] = (attributes, data.references)
    return found


async def by_asyncua(made, item):
    (result,) = await made.session.add_nodes([item])
    result.StatusCode.check()
    return result.AddedNodeId


async def property_by_asyncua(made, parent, name, value, data_type=None):
    nodeid = ua.NodeId(f"{parent.Identifier}.{name}", made.namespace_index)
    added = await Node(made.session, parent).add_property(
        nodeid, ua.QualifiedName(name, 0), value, datatype=data_type
    )
    if isinstance(value, list):  # asyncua leaves it open that they have one dimension
        rank = ua.Variant(ua.ValueRank.OneDimension, ua.VariantType.Int32)
        await added.write_attribute(ua.AttributeIds.ValueRank, ua.DataValue(rank))


async def test_they_have_the_same_attributes_and_references(monkeypatch):
    ours = described(await filled(await server()))
    monkeypatch.setattr(nodes_module, "_add", by_asyncua)
    monkeypatch.setattr(nodes_module, "add_property", property_by_asyncua)
    theirs = described(await filled(await server()))
    assert list(ours) == list(theirs)
    for id_, (attributes, references) in theirs.items():
        assert ours[id_][0] == attributes, id_
        assert ours[id_][1] == references, id_


async def test_a_node_that_is_there_already_or_has_no_parent_is_refused():
    made = await server()
    await add_object(made, None, "Thing")
    with pytest.raises(ServerError, match=r"s=Thing: cannot be added: BadNodeIdExists"):
        await add_object(made, None, "Thing")
    with pytest.raises(ServerError, match=r"s=X: cannot be added: BadParentNodeIdInvalid"):
        await add_object(made, ua.NodeId("nowhere", made.namespace_index), "X")
    with pytest.raises(ServerError, match=r"s=Y: cannot be added: BadTypeDefinitionInvalid"):
        await add_object(made, None, "Y", type_definition=ua.NodeId("no type", 1))


LATE = "Late", "Late.x", "Late.Part", "Late.Part.y", "Late.Do"


async def with_late_nodes(*, later):
    made = await server()
    calls = []
    folder = await add_object(made, None, "Late", description="Made when looked at")

    async def add():
        calls.append(made.utc())
        await add_variable(made, folder, "Late.x", 1.0, unit=Unit.BAR, value_range=(0.0, 2.0))
        part = await add_object(made, folder, "Late.Part")
        await add_variable(made, part, "Late.Part.y", 2.0, writable_by=Role.OPERATOR)
        await add_method(made, folder, "Late.Do", lambda: None, required=Role.OBSERVER)

    if later:
        made.add_later(folder, add)
    else:
        await add()
    return made, calls


async def test_nodes_that_are_made_when_somebody_looks_are_the_same_nodes():
    late, calls = await with_late_nodes(later=True)
    assert not calls
    early, _ = await with_late_nodes(later=False)
    assert described(late) == described(early)
    assert len(calls) == 1


@pytest.mark.parametrize("name", LATE)
@pytest.mark.parametrize("how", ["read", "look", "ask"])
async def test_a_look_at_any_of_them_makes_them_once(name, how):
    made, calls = await with_late_nodes(later=True)
    space, id_ = made.address_space, ua.NodeId(name, made.namespace_index)
    await add_object(made, None, "Later")  # its name begins like theirs
    assert ua.NodeId("Later", made.namespace_index) in space
    assert not calls
    if how == "read":
        assert space.read_attribute_value(id_, ua.AttributeIds.BrowseName).StatusCode.is_good()
    elif how == "look":
        assert space.get(id_).nodeid == id_
    else:
        assert id_ in space
    assert len(calls) == 1
    assert all(ua.NodeId(one, made.namespace_index) in space for one in LATE)
    assert ua.NodeId("Late.nothing", made.namespace_index) not in space
    assert space.get(ua.NodeId("Late.nothing", made.namespace_index)) is None
    assert len(calls) == 1


async def test_a_folder_in_a_folder_is_filled_when_it_is_looked_into():
    made, filled = await server(), []
    outer = await add_object(made, None, "Outer")

    async def add_inner(folder):
        filled.append("inner")
        await add_variable(made, folder, "Outer.Inner.x", 1.0)

    async def add_outer():
        filled.append("outer")
        inner = await add_object(made, outer, "Outer.Inner")
        made.add_later(inner, lambda: add_inner(inner))

    made.add_later(outer, add_outer)
    space, index = made.address_space, made.namespace_index
    assert [ref.NodeId for ref in space[ua.NodeId("Outer", index)].references if ref.IsForward][1:]
    assert filled == ["outer"]
    assert ua.NodeId("Outer.Inner.x", index) in space
    assert filled == ["outer", "inner"]


async def test_what_is_not_there_in_a_folder_that_nobody_looked_at_is_unknown():
    made, calls = await with_late_nodes(later=True)
    unknown = ua.NodeId("Late.nothing", made.namespace_index)
    found = made.address_space.read_attribute_value(unknown, ua.AttributeIds.Value)
    assert found.StatusCode.value == ua.StatusCodes.BadNodeIdUnknown
    assert len(calls) == 1


async def test_values_are_as_old_as_the_folder_not_as_the_first_look():
    clock = ManualClock(1_800_000_000_000_000_000)
    made = await server(clock)
    folder = await add_object(made, None, "Late")

    async def add():
        await add_variable(made, folder, "Late.x", 1.0)

    made.add_later(folder, add)
    began = made.utc()
    clock.advance(60.0)
    id_ = ua.NodeId("Late.x", made.namespace_index)
    held = made.address_space.read_attribute_value(id_, ua.AttributeIds.Value)
    assert held.SourceTimestamp == began
    assert made.utc() > began
