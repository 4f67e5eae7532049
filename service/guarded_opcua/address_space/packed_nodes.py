"""Nodes that come into being when somebody first asks for them.

The standard nodes are bytes until then. There are 6,000 of them, and hardly a client looks at a
hundred: a server that unpacks them all starts half a second later and carries half a million
objects. What a server holds of each of a thousand things alike is a function until then.
"""

import gc
import pickle
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, TypeVar

from asyncua import ua
from asyncua.server.address_space import AddressSpace, NodeData

_FREEZE_EVERY = 128  # nodes: they stay for ever, a collector that looks at all stops every client

T = TypeVar("T")
_Name = tuple[int, str]


def pack(nodes: Mapping[ua.NodeId, NodeData]) -> dict[ua.NodeId, bytes]:
    """Each node on its own."""
    return {id_: pickle.dumps(node, pickle.HIGHEST_PROTOCOL) for id_, node in nodes.items()}


def make_later(aspace: AddressSpace, folder: ua.NodeId, make: Callable[[], None]) -> None:
    """Have the nodes below a folder added by ``make`` when somebody first looks at one of them.

    Their identifiers begin with the folder's and a dot; so no other node's may.
    """
    nodes = aspace._nodes  # noqa: SLF001 - as AddressSpace.load does
    assert isinstance(nodes, PackedNodes)  # noqa: S101 - see load_standard_address_space
    nodes.make_later(folder, make)


def is_below(index: int, name: str, folders: Collection[_Name]) -> bool:
    """Whether an identifier is one of the folders', or of what is below one of them.

    >>> is_below(1, "V1.RLS.Residual", {(1, "V1")}), is_below(1, "V11.RLS", {(1, "V1")})
    (True, False)
    """
    parts = name.split(".")
    return any((index, ".".join(parts[:n])) in folders for n in range(1, len(parts) + 1))


class PackedNodes(dict[ua.NodeId, NodeData]):
    """What :class:`asyncua.server.address_space.AddressSpace` keeps its nodes in.

    Parameters
    ----------
    packed
        From :func:`pack`, of a source that is trusted: unpacking runs what it says.

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
        """See :func:`make_later`; the folder is put aside until then, it has no children yet."""
        self._later[folder.NamespaceIndex, str(folder.Identifier)] = self.pop(folder), make

    def take_away(self, folders: Collection[ua.NodeId]) -> list[NodeData]:
        """Forget folders and all below them, made or not; return what was made."""
        names = {(folder.NamespaceIndex, str(folder.Identifier)) for folder in folders}
        for later in [later for later in self._later if is_below(*later, names)]:
            del self._later[later]
        ids = super().__iter__()
        below = [id_ for id_ in ids if is_below(id_.NamespaceIndex, str(id_.Identifier), names)]
        return [self.pop(id_) for id_ in below]

    def __missing__(self, id_: ua.NodeId) -> NodeData:
        """Make or unpack a node that nobody asked for yet."""
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
        """The node, or the default."""
        try:
            return self[id_]
        except KeyError:
            return default

    def keys(self) -> Any:  # noqa: ANN401 - a view of dict, or a list
        """All ids, made and unpacked or not."""
        return list(self)

    def clear(self) -> None:
        """Forget all."""
        self._packed.clear()
        self._later.clear()
        super().clear()

    def _made(self, id_: ua.NodeId) -> bool:
        """Make the nodes that this one is among, folder by folder; False if none are to be made."""
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
