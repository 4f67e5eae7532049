"""Nodes put straight into the address space are those that asyncua would have made."""

import pytest
from asyncua import ua
from asyncua.common.node import Node

from service.hardened import HardenedServer, Role, ServerSettings, Unit, add_object
from service.hardened.address_space import nodes as nodes_module
from service.hardened.address_space.nodes import Argument, add_method, add_variable
from service.hardened.errors import ServerError

pytestmark = pytest.mark.asyncio


async def server():
    return await HardenedServer.create(
        ServerSettings(
            url="opc.tcp://127.0.0.1:0/",
            application_uri="urn:test:nodes",
            application_name="nodes",
            namespace_uri="urn:test",
            none_on_loopback=True,
        )
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


async def property_by_asyncua(made, parent, name, value):
    nodeid = ua.NodeId(f"{parent.Identifier}.{name}", made.namespace_index)
    await Node(made.session, parent).add_property(nodeid, ua.QualifiedName(name, 0), value)


async def test_they_have_the_same_attributes_and_references(monkeypatch):
    ours = described(await filled(await server()))
    monkeypatch.setattr(nodes_module, "_add", by_asyncua)
    monkeypatch.setattr(nodes_module, "_add_property", property_by_asyncua)
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
