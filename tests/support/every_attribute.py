"""Every attribute of every node of a server, as clients read them at each click on a node."""

from collections import Counter

from asyncua import ua

ATTRIBUTES = range(1, 28)
_BROWSED_AT_ONCE = 200
_ROOT = ua.NodeId(ua.ObjectIds.RootFolder)


async def every_node(client):
    """Return the NodeIds of all nodes that references lead to, from the root on."""
    found, open_ = {_ROOT: None}, [_ROOT]
    while open_:
        batch, open_ = open_[:_BROWSED_AT_ONCE], open_[_BROWSED_AT_ONCE:]
        params = ua.BrowseParameters(
            NodesToBrowse=[
                ua.BrowseDescription(id_, ua.BrowseDirection.Forward, ResultMask=0) for id_ in batch
            ]
        )
        for result in await client.uaclient.browse(params):
            for reference in result.References:
                if reference.NodeId not in found:
                    found[reference.NodeId] = None
                    open_.append(reference.NodeId)
            assert not result.ContinuationPoint
    return list(found)


async def read_every(client, ids):
    """Read all attributes of nodes: data values by node and attribute, and how many faults."""
    values, faults = {}, 0
    for id_ in ids:
        params = ua.ReadParameters(
            TimestampsToReturn=ua.TimestampsToReturn.Both,
            NodesToRead=[ua.ReadValueId(id_, attribute) for attribute in ATTRIBUTES],
        )
        try:
            found = await client.uaclient.read(params)
        except ua.UaStatusCodeError:
            faults += 1
            continue
        for attribute, value in zip(ATTRIBUTES, found, strict=True):
            values[id_, attribute] = value
    return values, faults


def codes_of(values):
    """Count the status codes."""
    return Counter(value.StatusCode.value for value in values.values())
