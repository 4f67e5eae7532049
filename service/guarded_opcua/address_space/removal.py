"""Removal of nodes while a server runs."""

from collections.abc import Collection

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from guarded_opcua.address_space.packed_nodes import PackedNodes
from guarded_opcua.address_space.watchers import notify
from guarded_opcua.binary.encoding import instant


def remove(
    aspace: AddressSpace,
    folders: Collection[ua.NodeId],
    referrers: Collection[ua.NodeId],
    now: int,
) -> list[ua.NodeId]:
    """Remove folders and all nodes below; their monitored items report BadNodeIdUnknown.

    Parameters
    ----------
    folders
        Objects; the identifiers of nodes below begin with the object's and a dot.
    referrers
        All other nodes that refer to them.
    now
        UTC ns.

    Returns
    -------
    list
        The removed nodes that had been created.
    """
    nodes = aspace._nodes  # noqa: SLF001 - as AddressSpace.load does
    assert isinstance(nodes, PackedNodes)  # noqa: S101 - see load_standard_address_space
    made = nodes.take_away(folders)
    unknown = ua.DataValue(
        ua.Variant(),
        ua.StatusCode(ua.StatusCodes.BadNodeIdUnknown),
        instant(now),
        instant(now),
    )
    every = {
        id(held): held for node in made for held in node.attributes.values()
    }  # some are shared
    for held in every.values():
        if held.datachange_callbacks:
            notify(held, unknown)
            for handle in list(held.datachange_callbacks):
                aspace._handle_to_attribute_map.pop(handle, None)  # noqa: SLF001 - its way
    gone = set(folders)
    for referrer in referrers:
        node = nodes[referrer]
        node.references = [ref for ref in node.references if ref.NodeId not in gone]
    return [node.nodeid for node in made]
