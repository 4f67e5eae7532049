"""Every attribute of every node of a server, as clients read them at each click on a node."""

from dataclasses import dataclass, field

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


@dataclass
class Found:
    """What a client reads of all nodes: status codes and nulls by (node, attribute), classes."""

    codes: dict = field(default_factory=dict)
    nulls: set = field(default_factory=set)
    classes: dict = field(default_factory=dict)
    faults: int = 0

    def take(self, id_, values):
        for attribute, value in zip(ATTRIBUTES, values, strict=True):
            self.codes[id_, attribute] = value.StatusCode.value
            if value.Value is None or value.Value.Value is None:
                self.nulls.add((id_, attribute))
        self.classes[id_] = ua.NodeClass(values[ua.AttributeIds.NodeClass - 1].Value.Value)


async def read_every(client, ids):
    """Read all attributes of each node in one request."""
    found = Found()
    for id_ in ids:
        params = ua.ReadParameters(
            TimestampsToReturn=ua.TimestampsToReturn.Both,
            NodesToRead=[ua.ReadValueId(id_, attribute) for attribute in ATTRIBUTES],
        )
        try:
            found.take(id_, await client.uaclient.read(params))
        except ua.UaStatusCodeError:
            found.faults += 1
    return found
