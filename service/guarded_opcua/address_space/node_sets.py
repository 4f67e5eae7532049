"""Nodes of other namespaces, imported from UANodeSets (Part 6, annex F) with their ids."""

from asyncua import Server, ua
from asyncua.server.address_space import AddressSpace, AttributeValue

from guarded_opcua.address_space.insertion import reference

_WRITING = 1 << ua.AccessLevel.CurrentWrite | 1 << ua.AccessLevel.HistoryWrite
_LEVELS = ua.AttributeIds.AccessLevel, ua.AttributeIds.UserAccessLevel


async def import_node_set(server: Server, aspace: AddressSpace, text: str) -> None:
    """Add the nodes of a UANodeSet; their access levels are set to read-only."""
    for id_ in await server.import_xml(xmlstring=text.encode(), auto_load_definitions=False):
        attributes = aspace[id_].attributes
        _mark_array(attributes.get(ua.AttributeIds.Value))
        for level in _LEVELS:
            held = attributes.get(level)
            if held is not None and held.value is not None:
                readable = held.value.Value.Value & ~_WRITING
                held.value = ua.DataValue(ua.Variant(readable, ua.VariantType.Byte))


def _mark_array(held: AttributeValue | None) -> None:
    """Mark a list of values as an array; asyncua's importer leaves some unmarked."""
    content = None if held is None or held.value is None else held.value.Value
    if content is not None and isinstance(content.Value, list):
        content.is_array = True


def refer(aspace: AddressSpace, source: ua.NodeId, kind: int, target: ua.NodeId) -> None:
    """Add a forward reference from a node to another.

    The target gets the inverse reference from :func:`refer_back`; for a lazy folder, call that
    when the folder is populated.
    """
    aspace[source].references.append(reference(ua.NodeId(kind), aspace[target], forward=True))


def refer_back(aspace: AddressSpace, source: ua.NodeId, kind: int, target: ua.NodeId) -> None:
    """Add the inverse reference from a node to another that refers to it."""
    aspace[target].references.append(reference(ua.NodeId(kind), aspace[source], forward=False))
