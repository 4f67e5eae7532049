"""The standard nodes as bytes, each unpacked when somebody first asks for it.

There are 6,000 of them, and hardly a client looks at a hundred: a server that unpacks them all
starts half a second later and carries half a million objects.
"""

import gc
import pickle
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

from asyncua import ua
from asyncua.server.address_space import NodeData

_FREEZE_EVERY = 128  # nodes: they stay for ever, a collector that looks at all stops every client

T = TypeVar("T")


def pack(nodes: Mapping[ua.NodeId, NodeData]) -> dict[ua.NodeId, bytes]:
    """Each node on its own."""
    return {id_: pickle.dumps(node, pickle.HIGHEST_PROTOCOL) for id_, node in nodes.items()}


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

    def __missing__(self, id_: ua.NodeId) -> NodeData:
        """Unpack a node that nobody asked for yet."""
        node: NodeData = pickle.loads(self._packed.pop(id_))  # noqa: S301 - trusted, see above
        self[id_] = node
        if len(self._packed) % _FREEZE_EVERY == 0:
            gc.freeze()
        return node

    def __contains__(self, id_: object) -> bool:
        return super().__contains__(id_) or id_ in self._packed

    def __iter__(self) -> Iterator[ua.NodeId]:
        yield from super().__iter__()
        yield from self._packed

    def __len__(self) -> int:
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
        """All ids, unpacked or not."""
        return list(self)

    def clear(self) -> None:
        """Forget all."""
        self._packed.clear()
        super().clear()
