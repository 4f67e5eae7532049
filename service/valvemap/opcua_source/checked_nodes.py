"""The nodes that a source subscribes to and writes to, each checked at the server."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from asyncua import ua

from valvemap.errors import SourceRejected
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_client.requests import namespaces_of
from valvemap.opcua_source.members import Member
from valvemap.opcua_source.node_looks import look, variant_type
from valvemap.opcua_source.source_nodes import ValveNodes, copies_of, wanted_nodes


@dataclass(frozen=True)
class MonitoredNode:
    """A node to subscribe to, the item number of its changes, and their type (None: unknown).

    ``place`` is the signal's place in an array or a structure; None: the value itself.
    """

    item: int
    node: ua.NodeId
    label: str
    type: int | None = None
    place: int | Member | None = None

    @property
    def index_range(self) -> str | None:
        """The element in requests for it alone (Part 4, 7.27)."""
        return str(self.place) if isinstance(self.place, int) else None


@dataclass(frozen=True)
class WritableNode:
    """A node to write to, its data type, and its label in error messages."""

    node: ua.NodeId
    type: ua.VariantType
    label: str


@dataclass(frozen=True)
class CheckedNodes:
    """The nodes to subscribe to, and the nodes to write to by valve and role.

    ``faults`` are the unusable nodes by item, as sentences; ``namespaces`` the NamespaceArray.
    """

    monitored: tuple[MonitoredNode, ...]
    writable: dict[tuple[int, str], WritableNode]
    faults: Mapping[int, str] = field(default_factory=dict)
    namespaces: tuple[str, ...] = ()


async def check_nodes(
    connection: Connection,
    valves: Sequence[ValveNodes],
    before: Sequence[str] = (),
    *,
    lenient: bool = False,
) -> CheckedNodes:
    """Read every node once.

    ``before`` is the NamespaceArray for which ``ns=<index>`` was meant; empty: the present one.
    If ``lenient``, unusable nodes are left out, unless all are unusable.

    Raises
    ------
    SourceRejected
        if a node is missing, unreadable, not writable or not a number; names the first one.
    SourceLost
    """
    wanted = list(wanted_nodes(valves))
    namespaces = await namespaces_of(connection)
    looked = await look(connection, wanted, namespaces, before)
    monitored, writable, faults = [], {}, {}
    copies = {item for items in copies_of(valves).values() for item in items}
    for number, (node, found) in enumerate(zip(wanted, looked, strict=True)):
        if found.fault is not None or found.node is None:
            faults[number] = f"{node.label} {found.fault}"
        elif node.item is None:
            kind = variant_type(found.type)
            writable[node.valve, node.role] = WritableNode(found.node, kind, node.label)
        elif node.item not in copies:
            own = MonitoredNode(node.item, found.node, node.label, found.type, found.place)
            monitored.append(own)
    if faults and not (lenient and monitored):
        more = f" (and {len(faults) - 1} more nodes)" if len(faults) > 1 else ""
        raise SourceRejected(next(iter(faults.values())) + more)
    of_items = {item: said for n, said in faults.items() if (item := wanted[n].item) is not None}
    return CheckedNodes(tuple(monitored), writable, of_items, tuple(before or namespaces))
