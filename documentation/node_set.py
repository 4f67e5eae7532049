"""The types of service and rig as UANodeSets (Part 6, annex F), exported from their servers."""

import asyncio
from collections.abc import Iterator
from dataclasses import fields
from typing import Any
from xml.etree import ElementTree as ET

from asyncua import ua
from asyncua.server.address_space import AddressSpace, NodeData

from guarded_opcua import ServerSettings
from valvemap.app.build import build_identification
from valvemap.app.identities import APPLICATION_URI
from valvemap.config.models import Config
from valvemap.opcua_results.information_model import TYPES
from valvemap.opcua_results.namespaces import RIG_NAMESPACE
from valvemap.opcua_results.results_server import NAMESPACE, ResultsServer
from valvemap_rig.scenario import BUILTIN
from valvemap_rig.server import RigServer

_NODES = "http://opcfoundation.org/UA/2011/03/UANodeSet.xsd"
_VALUES = "http://opcfoundation.org/UA/2008/02/Types.xsd"
_STANDARD = {"ModelUri": "http://opcfoundation.org/UA/", "Version": "1.04.10"}
_PUBLISHED = f"{ServerSettings.namespace_published:%Y-%m-%dT%H:%M:%SZ}"
_Attribute = ua.AttributeIds
_TAGS = {
    ua.NodeClass.Object: "UAObject",
    ua.NodeClass.Variable: "UAVariable",
    ua.NodeClass.Method: "UAMethod",
    ua.NodeClass.ObjectType: "UAObjectType",
    ua.NodeClass.DataType: "UADataType",
}
_OWN_PARENT = (ua.NodeClass.ObjectType, ua.NodeClass.DataType)
_HAS_SUBTYPE = ua.NodeId(ua.ObjectIds.HasSubtype)
_HAS_PROPERTY = ua.NodeId(ua.ObjectIds.HasProperty)
_HAS_COMPONENT = ua.NodeId(ua.ObjectIds.HasComponent)
_WANTED = (  # references written at the node itself; components refer to their parent
    ua.NodeId(ua.ObjectIds.HasTypeDefinition),
    ua.NodeId(ua.ObjectIds.HasModellingRule),
)


def node_set() -> str:
    """Return all types of the results server, as XML."""
    return asyncio.run(_made())


def rig_node_set() -> str:
    """Return all types of the rig, as XML."""
    return asyncio.run(_made_of_rig())


def _settings(namespace: str) -> ServerSettings:
    return ServerSettings(
        url="opc.tcp://127.0.0.1:0/",
        application_uri=APPLICATION_URI,
        application_name="node set",
        namespace_uri=namespace,
        none_on_loopback=True,
    )


async def _made_of_rig() -> str:
    rig = await RigServer.create(_settings(RIG_NAMESPACE), BUILTIN["demo"])
    inside = rig._server  # noqa: SLF001 - the client API exposes less
    return written(inside.address_space, inside.namespace_index, RIG_NAMESPACE)


async def _made() -> str:
    identification = build_identification(Config())
    settings = _settings(NAMESPACE)
    async with ResultsServer(settings, identification.descriptions(), identification) as server:
        inside = server._server  # noqa: SLF001 - the client API exposes less
        assert inside is not None  # noqa: S101 - it was started
        return written(inside.address_space, inside.namespace_index, NAMESPACE)


def written(aspace: AddressSpace, index: int, uri: str) -> str:
    """Return the types of one namespace: enumerations, objects with instance declarations."""
    ET.register_namespace("", _NODES)
    ET.register_namespace("uax", _VALUES)
    root = ET.Element(f"{{{_NODES}}}UANodeSet", LastModified=_PUBLISHED)
    _add(_add(root, "NamespaceUris"), "Uri", uri)
    about = {
        "ModelUri": uri,
        "Version": ServerSettings.namespace_version,
        "PublicationDate": _PUBLISHED,
    }
    model = _add(_add(root, "Models"), "Model", None, **about)
    _add(model, "RequiredModel", None, **_STANDARD, PublicationDate="2021-09-15T00:00:00Z")
    for node, parent in _types(aspace, index):
        _write(root, node, parent)
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, "unicode") + "\n"


def _types(aspace: AddressSpace, index: int) -> Iterator[tuple[NodeData, ua.NodeId]]:
    for base in (ua.NodeId(ua.ObjectIds.Enumeration), ua.NodeId(ua.ObjectIds.BaseObjectType)):
        for found in list(aspace[base].references):
            id_ = found.NodeId
            is_ours = id_.NamespaceIndex == index and str(id_.Identifier).startswith(f"{TYPES}.")
            if found.IsForward and found.ReferenceTypeId == _HAS_SUBTYPE and is_ours:
                yield aspace[id_], base
                yield from _below(aspace, id_)


def _below(aspace: AddressSpace, parent: ua.NodeId) -> Iterator[tuple[NodeData, ua.NodeId]]:
    for part in list(aspace[parent].references):
        is_own = str(part.NodeId.Identifier).startswith(f"{parent.Identifier}.")
        if part.IsForward and is_own:
            yield aspace[part.NodeId], parent
            yield from _below(aspace, part.NodeId)


def _write(root: ET.Element, node: NodeData, parent: ua.NodeId) -> None:
    held = {key: value.value for key, value in node.attributes.items() if value.value is not None}

    def value(attribute: ua.AttributeIds) -> object:
        data = held.get(attribute)
        return None if data is None or data.Value is None else data.Value.Value

    kind = ua.NodeClass(value(_Attribute.NodeClass))
    name = value(_Attribute.BrowseName)
    stated = {"NodeId": _id(node.nodeid), "BrowseName": _name(name)}
    if kind == ua.NodeClass.Variable:
        stated["DataType"] = _id(value(_Attribute.DataType))
        stated["ValueRank"] = str(int(value(_Attribute.ValueRank)))
        dimensions = value(_Attribute.ArrayDimensions)
        if dimensions:
            stated["ArrayDimensions"] = ",".join(map(str, dimensions))
        stated["AccessLevel"] = str(value(_Attribute.AccessLevel))
    if kind not in _OWN_PARENT:
        stated["ParentNodeId"] = _id(parent)
    made = _add(root, _TAGS[kind], None, **stated)
    _add(made, "DisplayName", value(_Attribute.DisplayName).Text)
    description = value(_Attribute.Description)
    if description is not None and description.Text:
        _add(made, "Description", description.Text)
    references = _add(made, "References")
    for ref in node.references:
        if ref.IsForward and ref.ReferenceTypeId in _WANTED:
            _refer(references, ref.ReferenceTypeId, ref.NodeId, forward=True)
        elif not ref.IsForward and ref.NodeId == parent:
            _refer(references, ref.ReferenceTypeId, parent, forward=False)
    _write_content(made, name.Name, held)


def _write_content(made: ET.Element, name: str, held: dict[ua.AttributeIds, Any]) -> None:
    """Write a variable's value, or an enumeration's definition."""
    definition, data = held.get(_Attribute.DataTypeDefinition), held.get(_Attribute.Value)
    if definition is not None:
        _write_definition(made, name, definition.Value.Value)
    if data is not None and data.Value is not None and data.Value.Value is not None:
        _write_value(made, data.Value)


def _write_definition(made: ET.Element, name: str, definition: Any) -> None:  # noqa: ANN401
    box = _add(made, "Definition", None, Name=f"1:{name}")
    for field in definition.Fields:
        one = _add(box, "Field", None, Name=field.Name, Value=str(field.Value))
        _add(one, "Description", field.Description.Text)


def _write_value(made: ET.Element, variant: ua.Variant) -> None:
    """Write the value of a property: a text or a standard structure."""
    box = ET.SubElement(made, f"{{{_NODES}}}Value")
    if variant.VariantType == ua.VariantType.LocalizedText and variant.is_array:
        several = ET.SubElement(box, _typed("ListOfLocalizedText"))
        for text in variant.Value:
            ET.SubElement(
                ET.SubElement(several, _typed("LocalizedText")), _typed("Text")
            ).text = text.Text
        return
    if variant.VariantType == ua.VariantType.LocalizedText:
        one = ET.SubElement(box, _typed("LocalizedText"))
        ET.SubElement(one, _typed("Text")).text = variant.Value.Text
        return
    if variant.VariantType == ua.VariantType.ExtensionObject:
        values = variant.Value if variant.is_array else [variant.Value]
        holder = ET.SubElement(box, _typed("ListOfExtensionObject")) if variant.is_array else box
        for value in values:
            _write_structure(holder, value)
        return
    made.remove(box)


def _write_structure(holder: ET.Element, value: object) -> None:
    box = ET.SubElement(holder, _typed("ExtensionObject"))
    name = type(value).__name__
    number = getattr(ua.ObjectIds, f"{name}_Encoding_DefaultXml")
    ET.SubElement(ET.SubElement(box, _typed("TypeId")), _typed("Identifier")).text = f"i={number}"
    body = ET.SubElement(ET.SubElement(box, _typed("Body")), _typed(name))
    _write_fields(body, value)


def _write_fields(body: ET.Element, structure: Any) -> None:  # noqa: ANN401 - any structure
    for field in fields(structure):
        if field.name not in ("Encoding", "TypeId"):
            _write_field(body, field.name, getattr(structure, field.name))


def _write_field(body: ET.Element, field: str, content: object) -> None:
    if content is None:
        return
    own = ET.SubElement(body, _typed(field))
    match content:
        case ua.LocalizedText():
            ET.SubElement(own, _typed("Text")).text = content.Text
        case ua.NodeId():
            ET.SubElement(own, _typed("Identifier")).text = _id(content)
        case ua.AxisScaleEnumeration():
            own.text = f"{content.name}_{content.value}"
        case list():
            tag = "UInt32" if field == "ArrayDimensions" else "Double"
            for one in content:
                ET.SubElement(own, _typed(tag)).text = str(one)
        case int() | float() | str():
            own.text = str(int(content) if isinstance(content, ua.ValueRank) else content)
        case _:
            _write_fields(own, content)


def _refer(references: ET.Element, kind: ua.NodeId, to: ua.NodeId, *, forward: bool) -> None:
    stated = {"ReferenceType": _id(kind)} | ({} if forward else {"IsForward": "false"})
    _add(references, "Reference", _id(to), **stated)


def _add(parent: ET.Element, tag: str, text: str | None = None, **stated: str) -> ET.Element:
    made = ET.SubElement(parent, f"{{{_NODES}}}{tag}", stated)
    made.text = text
    return made


def _id(id_: object) -> str:
    assert isinstance(id_, ua.NodeId)  # noqa: S101 - of our own nodes
    if id_.NamespaceIndex == 0:
        return f"i={id_.Identifier}"
    return f"ns=1;s={id_.Identifier}"


def _name(name: object) -> str:
    assert isinstance(name, ua.QualifiedName)  # noqa: S101 - of our own nodes
    return name.Name if name.NamespaceIndex == 0 else f"1:{name.Name}"


def _typed(tag: str) -> str:
    return f"{{{_VALUES}}}{tag}"
