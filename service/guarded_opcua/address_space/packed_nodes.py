"""Nodes that are created on first access.

The 6,000 standard nodes are stored pickled. Few clients access more than a hundred of them;
unpickling all at start takes half a second and creates half a million objects. The nodes below a
lazy folder are stored as a function that creates them.
"""

import gc
import pickle
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, TypeVar

from asyncua import ua
from asyncua.server.address_space import AddressSpace, NodeData

_FREEZE_EVERY = 128  # nodes; these live as long as the server, so exempt them from full collections

T = TypeVar("T")
_Name = tuple[int, str]


def pack(nodes: Mapping[ua.NodeId, NodeData]) -> dict[ua.NodeId, bytes]:
    """Return the nodes, each pickled separately."""
    return {id_: pickle.dumps(node, pickle.HIGHEST_PROTOCOL) for id_, node in nodes.items()}


def make_later(aspace: AddressSpace, folder: ua.NodeId, make: Callable[[], None]) -> None:
    """Register ``make`` to create the nodes below a folder when one of them is first accessed.

    Their identifiers begin with the folder's identifier and a dot; no other node's may.
    """
    nodes = aspace._nodes  # noqa: SLF001 - as AddressSpace.load does
    assert isinstance(nodes, PackedNodes)  # noqa: S101 - see load_standard_address_space
    nodes.make_later(folder, make)


def is_below(index: int, name: str, folders: Collection[_Name]) -> bool:
    """Return whether an identifier is that of one of the folders or of a node below one.

    >>> is_below(1, "V1.RLS.Residual", {(1, "V1")}), is_below(1, "V11.RLS", {(1, "V1")})
    (True, False)
    """
    parts = name.split(".")
    return any((index, ".".join(parts[:n])) in folders for n in range(1, len(parts) + 1))


class PackedNodes(dict[ua.NodeId, NodeData]):
    """The node table of :class:`asyncua.server.address_space.AddressSpace`, created lazily.

    Parameters
    ----------
    packed
        Result of :func:`pack`, from a trusted source, since unpickling executes code.

    Examples
    --------
    >>> id_ = ua.NodeId(85)
    >>> nodes = PackedNodes(pack({id_: NodeData(id_)}))
    >>> len(nodes), id_ in nodes, nodes[id_].nodeid == id_, len(nodes)
    (1, True, True, 1)
    """

    def __init__(self, packed: dict[ua.NodeId, bytes]) -> None:
        super().__init__()
        self._packed = packed
        self._later: dict[_Name, tuple[NodeData, Callable[[], None]]] = {}

    def make_later(self, folder: ua.NodeId, make: Callable[[], None]) -> None:
        """See :func:`make_later`; the folder, without children, is set aside until then."""
        self._later[folder.NamespaceIndex, str(folder.Identifier)] = self.pop(folder), make

    def take_away(self, folders: Collection[ua.NodeId]) -> list[NodeData]:
        """Remove folders and all nodes below, created or not; return the created ones."""
        names = {(folder.NamespaceIndex, str(folder.Identifier)) for folder in folders}
        for later in [later for later in self._later if is_below(*later, names)]:
            del self._later[later]
        ids = super().__iter__()
        below = [id_ for id_ in ids if is_below(id_.NamespaceIndex, str(id_.Identifier), names)]
        return [self.pop(id_) for id_ in below]

    def __missing__(self, id_: ua.NodeId) -> NodeData:
        """Create or unpickle a node on first access."""
        if self._made(id_):
            return self[id_]
        node: NodeData = pickle.loads(self._packed.pop(id_))  # noqa: S301 - trusted, see above
        self[id_] = node
        if len(self._packed) % _FREEZE_EVERY == 0:
            gc.freeze()
        return node

    def __contains__(self, id_: object) -> bool:
        if super().__contains__(id_) or id_ in self._packed:
            return True
        return isinstance(id_, ua.NodeId) and self._made(id_) and super().__contains__(id_)

    def __iter__(self) -> Iterator[ua.NodeId]:
        self._make_all()
        yield from super().__iter__()
        yield from self._packed

    def __len__(self) -> int:
        self._make_all()
        return super().__len__() + len(self._packed)

    def __setitem__(self, id_: ua.NodeId, node: NodeData) -> None:
        self._packed.pop(id_, None)
        super().__setitem__(id_, node)

    def __delitem__(self, id_: ua.NodeId) -> None:
        if self._packed.pop(id_, None) is None:
            super().__delitem__(id_)

    def get(self, id_: ua.NodeId, default: T | None = None) -> NodeData | T | None:
        """Return the node, or the default."""
        try:
            return self[id_]
        except KeyError:
            return default

    def keys(self) -> Any:  # noqa: ANN401 - a view of dict, or a list
        """Return all ids, of created and pickled nodes."""
        return list(self)

    def clear(self) -> None:
        """Remove all nodes."""
        self._packed.clear()
        self._later.clear()
        super().clear()

    def _made(self, id_: ua.NodeId) -> bool:
        """Populate the lazy folders above a node, outermost first; return whether any existed."""
        made, names = False, str(id_.Identifier).split(".") if self._later else ()
        for depth in range(1, len(names) + 1):
            later = self._later.pop((id_.NamespaceIndex, ".".join(names[:depth])), None)
            if later is not None:
                folder, make = later
                self[folder.nodeid] = folder
                make()
                made = True
        return made

    def _make_all(self) -> None:
        while self._later:
            for folder, _ in list(self._later.values()):
                self._made(folder.nodeid)
