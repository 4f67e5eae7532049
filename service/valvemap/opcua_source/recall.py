"""Reads all signals of a source for a time span from its history, in order."""

from collections.abc import AsyncIterator, Sequence

import numpy as np

from valvemap.errors import SourceRejected
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_source.checked_nodes import MonitoredNode
from valvemap.opcua_source.history import Holes, SourceHistory
from valvemap.pipeline.data_changes import DataChanges


async def recall(
    connection: Connection, nodes: Sequence[MonitoredNode], start: int, stop: int
) -> AsyncIterator[DataChanges]:
    """Yield changes from ``start`` to ``stop`` (UTC ns, both included), the oldest first.

    Raises
    ------
    SourceLost
    SourceRejected
        if the source keeps no history; the message has the remedy.
    """
    history = SourceHistory()
    history.over(connection, nodes)
    items = np.array(sorted(node.item for node in nodes), np.intp)
    low, high = np.full(len(items), start, np.int64), np.full(len(items), stop, np.int64)
    while (open_ := low <= high).any():
        holes = Holes(items[open_], low[open_], high[open_])
        changes, read, reached = await history.read(holes)
        if not history.is_there:
            raise SourceRejected(
                f"{connection.settings.url}: the server keeps no history of these signals; have it "
                "historize them, or record from now on: valvemap record"
            )
        low[np.isin(items, read.items)] = min(reached, stop) + 1
        if len(changes):
            yield changes
