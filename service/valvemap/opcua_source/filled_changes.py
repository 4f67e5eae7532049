"""Received changes in their order, with gaps filled from the source's history."""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace

from valvemap.opcua_client.connection import Connection
from valvemap.opcua_source.checked_nodes import MonitoredNode
from valvemap.opcua_source.history import NEVER, Holes, Knowledge, SourceHistory
from valvemap.opcua_source.position import Mark
from valvemap.opcua_source.received import Part, Tally
from valvemap.opcua_source.records import overflown
from valvemap.pipeline.data_changes import DataChanges


class FilledChanges:
    """The changes received from one source and not returned yet, over all connections.

    Attributes
    ----------
    parts
        Received, not returned yet.
    knowledge
        Up to when the changes of each item were returned.
    mark
        The position of the last returned changes; None before the first.

    Parameters
    ----------
    items
        Number of monitored items.
    history_s, warm_start_s
        Longest gap to fill, and length of the gap assumed before the first start, s; 0: none.
    """

    def __init__(self, items: int, history_s: float, warm_start_s: float) -> None:
        self.parts: deque[Part] = deque()
        self.knowledge = Knowledge(items)
        self.mark: Mark | None = None
        self._history = SourceHistory()
        self._longest_s = max(history_s, warm_start_s)
        self._warm_start_s = warm_start_s

    def read_history_over(self, connection: Connection, nodes: Iterable[MonitoredNode]) -> None:
        """Read missing changes over this connection from now on, if gaps are to be filled."""
        if self._longest_s > 0.0:
            self._history.over(connection, nodes)

    def begin_earlier(self, nodes: Sequence[MonitoredNode], now: int) -> None:
        """At the first start, mark the last ``warm_start_s`` as missed: the history fills them.

        ``now`` is the source's time, UTC ns.
        """
        known_to = self.knowledge.known_to
        if self._warm_start_s > 0.0 and (known_to == NEVER).all():
            known_to[[node.item for node in nodes]] = now - round(self._warm_start_s * 1e9)

    async def next(self, started: int, tally: Tally) -> DataChanges:
        """Return the next changes: received ones, or missed ones from the history before them.

        ``started`` is the start time of the server for the mark; missed changes are counted in
        ``tally``. Empty if the history has none of the missed ones; some part was received.
        """
        whole = 0
        for part in self.parts:
            if len(self._holes_before(part)):
                break
            self.knowledge.note(part.changes)
            whole += 1
        if whole:
            parts = [self.parts.popleft() for _ in range(whole)]
            last = parts[-1]
            known_to = self.knowledge.known_to.copy()
            self.mark = Mark(last.subscription, last.message, known_to, started)
            return DataChanges.concatenate([part.changes for part in parts])
        missed = await self._missed(self.parts[0], started)
        tally.from_history += len(missed)
        return missed

    def _holes_before(self, part: Part) -> Holes:
        """Return the gaps before a message that the source's history may fill."""
        known, changes = self.knowledge, part.changes
        if not self._history.is_there:
            return Holes.none()
        if part.behind_gap:
            known.doubt()
        if part.overflows:
            known.doubt(changes.item[overflown(changes.status)])
        if not known.doubtful.any():
            return Holes.none()
        return known.holes(changes, round(self._longest_s * 1e9))

    async def _missed(self, part: Part, started: int) -> DataChanges:
        """Read the oldest missed changes before a message; empty if the history has none."""
        known = self.knowledge
        changes, read, reached = await self._history.read(self._holes_before(part))
        known.fill(read, reached)
        before = self.mark or Mark(0, 0, known.known_to, started)
        self.mark = replace(before, known_to=known.known_to.copy())
        return changes
