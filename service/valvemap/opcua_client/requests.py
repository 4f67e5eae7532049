"""Batched requests within the server's limits: values, attributes, references."""

from collections.abc import Awaitable, Callable, Sequence
from typing import Final, TypeVar

from asyncua import ua

from valvemap.opcua_client.connection import Connection, OperationLimits

_In = TypeVar("_In")
_Out = TypeVar("_Out")

_HAS_PROPERTY: Final = ua.NodeId(ua.ObjectIds.HasProperty)
_DEFAULT_OPERATIONS: Final = 1_000
_MOST_OPERATIONS: Final = 10_000
_REFERENCES: Final = 500  # of a node in one response; the rest by BrowseNext
_BROWSED_AT_ONCE: Final = 20  # nodes of one request
_MOST_REFERENCES: Final = 100_000  # of one node; further references are not read


async def operation_limits(connection: Connection) -> OperationLimits:
    """Return the server's operation limits; 1,000 where it announces none.

    They are read once per connection.
    """
    if connection.limits is None:
        answers = await _read(
            connection,
            [
                ua.NodeId(ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead),
                ua.NodeId(
                    ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxMonitoredItemsPerCall
                ),
            ],
            (ua.AttributeIds.Value,),
            ua.TimestampsToReturn.Neither,
        )
        values = (None if value.Value is None else value.Value.Value for value in answers)
        connection.limits = OperationLimits(*(_operations(value) for value in values))
    return connection.limits


async def in_chunks(
    items: Sequence[_In], size: int, call: Callable[[Sequence[_In]], Awaitable[Sequence[_Out]]]
) -> list[_Out]:
    """Call with at most ``size`` items; halve the size after BadTooManyOperations."""
    results: list[_Out] = []
    while len(results) < len(items):
        try:
            chunk = items[len(results) : len(results) + size]
            answers = await call(chunk)
            if len(answers) != len(chunk):
                raise ValueError(f"{len(answers)} results for {len(chunk)} operations")
            results += answers
        except ua.uaerrors.BadTooManyOperations:
            if size == 1:
                raise
            size //= 2
    return results


async def read_values(
    connection: Connection,
    nodes: Sequence[ua.NodeId],
    timestamps: ua.TimestampsToReturn = ua.TimestampsToReturn.Neither,
) -> list[ua.DataValue]:
    """Read the values of variables, one DataValue each."""
    attributes = (ua.AttributeIds.Value,)
    return [one for (one,) in await read_attributes(connection, nodes, attributes, timestamps)]


async def read_attributes(
    connection: Connection,
    nodes: Sequence[ua.NodeId],
    attributes: Sequence[ua.AttributeIds],
    timestamps: ua.TimestampsToReturn = ua.TimestampsToReturn.Neither,
) -> list[list[ua.DataValue]]:
    """Read the same attributes of several nodes; one list per node, in their order."""
    width = len(attributes)

    async def read(some: Sequence[ua.NodeId]) -> list[list[ua.DataValue]]:
        answers = await _read(connection, some, attributes, timestamps)
        if len(answers) != width * len(some):
            raise ValueError(f"{len(answers)} values for {width * len(some)} attributes")
        return [answers[i * width : (i + 1) * width] for i in range(len(some))]

    limit = (await operation_limits(connection)).nodes_per_read
    return await in_chunks(nodes, max(limit // width, 1), read)


async def read_properties(
    connection: Connection, nodes: Sequence[ua.NodeId], names: Sequence[str]
) -> list[tuple[object, ...]]:
    """Read standard properties of nodes, one value per name; None where there is none."""
    limit = (await operation_limits(connection)).nodes_per_read
    paths = [_property_path(node, name) for node in nodes for name in names]
    session = connection.session
    found = await in_chunks(
        paths, limit, lambda some: session.translate_browsepaths_to_nodeids(list(some))
    )
    targets = [_target(result) for result in found]
    answers = iter(await read_values(connection, [one for one in targets if one is not None]))
    values = [None if target is None else _good_value(next(answers)) for target in targets]
    width = len(names)
    return [tuple(values[i : i + width]) for i in range(0, len(values), width)]


async def namespaces_of(connection: Connection) -> list[str]:
    """Read the server's NamespaceArray.

    Raises
    ------
    SourceLost, SourceRejected
    """
    with connection.errors("reading the NamespaceArray"):
        (answer,) = await read_values(connection, [ua.NodeId(ua.ObjectIds.Server_NamespaceArray)])
        uris = [uri or "" for uri in answer.Value.Value]
        if not all(isinstance(uri, str) for uri in uris):
            raise ValueError("namespaces that are no strings")
        return uris


async def children_of(
    connection: Connection, nodes: Sequence[ua.NodeId], classes: int = 0
) -> list[list[ua.ReferenceDescription]]:
    """Browse the forward hierarchical references of nodes; ``classes`` is a mask, 0 means all."""

    async def browse(some: Sequence[ua.NodeId]) -> list[list[ua.ReferenceDescription]]:
        results = await connection.session.browse(
            ua.BrowseParameters(
                View=ua.ViewDescription(),
                RequestedMaxReferencesPerNode=_REFERENCES,
                NodesToBrowse=[_description(node, classes) for node in some],
            )
        )
        return [await _all_of(connection, result) for result in results]

    return await in_chunks(nodes, _BROWSED_AT_ONCE, browse)


async def _read(
    connection: Connection,
    nodes: Sequence[ua.NodeId],
    attributes: Sequence[ua.AttributeIds],
    timestamps: ua.TimestampsToReturn,
) -> list[ua.DataValue]:
    wanted = [ua.ReadValueId(NodeId=node, AttributeId=one) for node in nodes for one in attributes]
    return await connection.session.read(
        ua.ReadParameters(TimestampsToReturn=timestamps, NodesToRead=wanted)
    )


def _property_path(node: ua.NodeId, name: str) -> ua.BrowsePath:
    element = ua.RelativePathElement(
        ReferenceTypeId=_HAS_PROPERTY,
        IsInverse=False,
        IncludeSubtypes=True,
        TargetName=ua.QualifiedName(name, 0),
    )
    return ua.BrowsePath(StartingNode=node, RelativePath=ua.RelativePath(Elements=[element]))


def _target(result: ua.BrowsePathResult) -> ua.NodeId | None:
    if not result.StatusCode.is_good() or not result.Targets:
        return None
    target = result.Targets[0].TargetId
    return ua.NodeId(target.Identifier, target.NamespaceIndex, target.NodeIdType)


def _good_value(answer: ua.DataValue) -> object:
    good = answer.StatusCode is None or answer.StatusCode.is_good()
    return answer.Value.Value if good and answer.Value is not None else None


def _operations(announced: object) -> int:
    if isinstance(announced, int) and announced > 0:
        return min(announced, _MOST_OPERATIONS)
    return _DEFAULT_OPERATIONS


def _description(node: ua.NodeId, classes: int) -> ua.BrowseDescription:
    return ua.BrowseDescription(
        NodeId=node,
        BrowseDirection=ua.BrowseDirection.Forward,
        ReferenceTypeId=ua.NodeId(ua.ObjectIds.HierarchicalReferences),
        IncludeSubtypes=True,
        NodeClassMask=classes,
        ResultMask=ua.BrowseResultMask.All,
    )


async def _all_of(connection: Connection, result: ua.BrowseResult) -> list[ua.ReferenceDescription]:
    references, point = list(result.References or ()), result.ContinuationPoint
    while point:
        enough = len(references) >= _MOST_REFERENCES
        (more,) = await connection.session.browse_next(
            ua.BrowseNextParameters(ReleaseContinuationPoints=enough, ContinuationPoints=[point])
        )
        if enough:
            break
        references += more.References or ()
        point = more.ContinuationPoint
    return references
