"""Fills gaps in the data changes from the source's history (raw HistoryRead)."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from guarded_opcua.binary.encoding import instant
from guarded_opcua.logs import bounded_logger
from valvemap.errors import SourceLost
from valvemap.opcua_client.connection import Connection
from valvemap.opcua_client.responses import Senseless
from valvemap.opcua_client.source_errors import status_name
from valvemap.opcua_source.checked_nodes import MonitoredNode
from valvemap.opcua_source.decoding import HistoryPiece, decode_history_response
from valvemap.opcua_source.wire import DecodeError
from valvemap.pipeline.data_changes import DataChanges
from valvemap.vocabulary.signals import PER_VALVE

_log = bounded_logger(__name__)

NEVER = -(2**63)
_VALUES_AT_ONCE = 6_000  # of all nodes together: 1,000 samples of a valve per request
_NODES_AT_ONCE = 16 * PER_VALVE
_TOGETHER_NS = 1_000_000_000  # holes that start within 1 s are read together
_MOST_FAILURES = 3  # in a row, then the hole is skipped: a failing history must not block
_MICROSECOND_NS = 1_000  # resolution of datetime
_UNSUPPORTED = {
    ua.StatusCodes.BadServiceUnsupported,
    ua.StatusCodes.BadHistoryOperationUnsupported,
    ua.StatusCodes.BadHistoryOperationInvalid,
    ua.StatusCodes.BadNotImplemented,
    ua.StatusCodes.BadNotSupported,
    ua.StatusCodes.BadUserAccessDenied,
    ua.StatusCodes.BadInvalidArgument,
    ua.StatusCodes.BadInvalidTimestampArgument,
    ua.StatusCodes.BadTimestampsToReturnInvalid,
}


class Knowledge:
    """The last known source time of each item, and which items may have missed changes since.

    Attributes
    ----------
    known_to : int64
        By item, UTC ns: all changes up to this time were returned. NEVER: none were.
    doubtful : bool
        By item: changes may be missing before the next one.
    """

    def __init__(self, items: int) -> None:
        self.known_to = np.full(items, NEVER, np.int64)
        self.doubtful = np.zeros(items, np.bool_)

    def doubt(self, items: NDArray[np.int32] | None = None) -> None:
        """Mark that changes may be missing before the next one of ``items``; None: of all."""
        if items is None:
            self.doubtful = self.known_to != NEVER
        else:
            self.doubtful[items[self._are_ours(items)]] = True

    def note(self, changes: DataChanges) -> None:
        """Record that these changes were returned."""
        ours = self._are_ours(changes.item)
        self.known_to[changes.item[ours]] = changes.source_time[ours]
        self.doubtful[changes.item[ours]] = False

    def holes(self, ahead: DataChanges, longest_ns: int) -> "Holes":
        """Return the possible gaps before the changes ``ahead``, at most ``longest_ns`` long.

        A gap in one signal includes the valve's other doubtful signals, so that samples are
        completed in order.
        """
        ahead = ahead[self._are_ours(ahead.item)]
        items, at = np.unique(ahead.item, return_index=True)
        first = np.full(len(self.known_to), NEVER, np.int64)
        first[items] = ahead.source_time[at]
        until = _of_valve(first.reshape(-1, PER_VALVE).max(axis=1))
        high = np.maximum(np.where(first == NEVER, until, first), NEVER + longest_ns + 1) - 1
        low = np.maximum(self.known_to + 1, high - longest_ns)
        missing = self.doubtful & (self.known_to != NEVER) & (low <= high)
        is_next = missing & (first != NEVER)
        beside = _of_valve(is_next.reshape(-1, PER_VALVE).any(axis=1))
        chosen = np.flatnonzero(missing & beside)
        return Holes(chosen, low[chosen], high[chosen])

    def fill(self, holes: "Holes", reached: int) -> None:
        """Record that the history of these holes was returned up to ``reached``."""
        self.known_to[holes.items] = np.minimum(holes.high, reached)

    def _are_ours(self, items: NDArray[np.int32]) -> NDArray[np.bool_]:
        return (items >= 0) & (items < len(self.known_to))


def _of_valve(by_valve: NDArray[Any]) -> NDArray[Any]:
    """Repeat a value per valve for each of its items."""
    return np.repeat(by_valve, PER_VALVE)


@dataclass(frozen=True)
class Holes:
    """Missing time spans by item, both ends included: arrays of equal length."""

    items: NDArray[np.intp]
    low: NDArray[np.int64]
    high: NDArray[np.int64]

    @classmethod
    def none(cls) -> "Holes":
        """Return no holes."""
        return cls(np.empty(0, np.intp), np.empty(0, np.int64), np.empty(0, np.int64))

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, rows: NDArray[np.bool_] | slice) -> "Holes":
        return Holes(self.items[rows], self.low[rows], self.high[rows])


class SourceHistory:
    """The history of one source, over all connections.

    Attributes
    ----------
    is_there
        Whether the source supports history reads; False before the first connection.
    """

    def __init__(self) -> None:
        self.is_there = False
        self._connection: Connection
        self._node_of: dict[int, MonitoredNode] = {}
        self._nodes_at_once = _NODES_AT_ONCE
        self._failures = 0

    def over(self, connection: Connection, nodes: Iterable[MonitoredNode]) -> None:
        """Use another connection from now on."""
        self.is_there = True
        self._connection = connection
        self._node_of = {node.item: node for node in nodes}
        self._nodes_at_once = _NODES_AT_ONCE

    async def read(self, holes: Holes) -> tuple[DataChanges, Holes, int]:
        """Read the oldest part of the given holes.

        Returns
        -------
        changes
            The changes of the source's history, in order of time.
        read, reached
            The holes that were read, and the time (UTC ns) up to which they were read.

        Raises
        ------
        SourceLost
        """
        oldest = holes[holes.low <= int(holes.low.min()) + _TOGETHER_NS][: self._nodes_at_once]
        most = max(_VALUES_AT_ONCE // len(oldest), 2)
        last = int(oldest.high.max())
        try:
            with self._connection.errors("reading the source's history"):
                pieces = await self._ask(oldest, most, last)
        except SourceLost:
            self._failures += 1
            if self._failures < _MOST_FAILURES:
                raise
            self._failures = 0
            return self._nothing(oldest, "it fails time and again")
        self._failures = 0
        if isinstance(pieces, str):
            return self._nothing(oldest, pieces)
        reached = min([last, *(_reached(piece, most) for piece in pieces)])
        parts = []
        for low, high, piece in zip(oldest.low, oldest.high, pieces, strict=True):
            t = piece.changes.source_time
            parts.append(piece.changes[(t >= low) & (t <= min(high, reached))])
        changes = DataChanges.concatenate(parts)
        in_order = np.lexsort((changes.item, changes.source_time))
        return changes[in_order], oldest, reached

    async def _ask(self, holes: Holes, most: int, last: int) -> list[HistoryPiece] | str:
        """Return the response for each hole, or the reason if there is none."""
        nodes = [self._node_of[item] for item in holes.items.tolist()]
        wanted = [
            ua.HistoryReadValueId(NodeId=node.node, IndexRange=node.index_range) for node in nodes
        ]
        details = ua.ReadRawModifiedDetails(
            IsReadModified=False,
            StartTime=instant(int(holes.low.min())),
            EndTime=instant(last + _MICROSECOND_NS),
            NumValuesPerNode=most,
            ReturnBounds=False,
        )
        try:
            data = await self._request(wanted, details, release=False)
        except ua.uaerrors.BadTooManyOperations:
            if self._nodes_at_once > 1:
                self._nodes_at_once //= 2
                return await self._ask(holes[: self._nodes_at_once], most, last)
            return "it takes no operation"
        except ua.UaStatusCodeError as error:
            if error.code not in _UNSUPPORTED:
                raise
            self.is_there = False
            return status_name(error.code)
        try:
            pieces = decode_history_response(
                data, holes.items.tolist(), [node.place for node in nodes]
            )
        except DecodeError as error:
            raise Senseless(f"a history that is not understood: {error}") from error
        await self._release(wanted, pieces, details)
        refused = [piece.status for piece in pieces if piece.status >> 31]
        if len(refused) == len(pieces):
            self.is_there = not _UNSUPPORTED.issuperset(refused)
            return status_name(refused[0])
        return pieces

    async def _release(
        self,
        wanted: Sequence[ua.HistoryReadValueId],
        pieces: Sequence[HistoryPiece],
        details: ua.ReadRawModifiedDetails,
    ) -> None:
        """Release the continuation points; the next read continues by time instead."""
        points = [
            ua.HistoryReadValueId(
                NodeId=value.NodeId, IndexRange=value.IndexRange, ContinuationPoint=piece.point
            )
            for value, piece in zip(wanted, pieces, strict=True)
            if piece.point
        ]
        if points:
            with suppress(ua.UaStatusCodeError):
                await self._request(points, details, release=True)

    async def _request(
        self,
        wanted: Sequence[ua.HistoryReadValueId],
        details: ua.ReadRawModifiedDetails,
        *,
        release: bool,
    ) -> bytes:
        request = ua.HistoryReadRequest()
        request.Parameters.HistoryReadDetails = details
        request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Source
        request.Parameters.ReleaseContinuationPoints = release
        request.Parameters.NodesToRead = list(wanted)
        return await self._connection.session.request(request)

    def _nothing(self, holes: Holes, why: str) -> tuple[DataChanges, Holes, int]:
        url = self._connection.settings.url
        _log.warning("%s: missed changes cannot be read from its history: %s", url, why)
        return DataChanges.empty(), holes, int(holes.high.max())


def _reached(piece: HistoryPiece, most: int) -> int:
    """Return the time (UTC ns) up to which a variable's history is known now."""
    t = piece.changes.source_time
    if not len(t) or (not piece.point and len(t) < most):
        return 2**63 - 1
    # further values with the last time may follow
    return int(t[-1]) - 1 if t[-1] > t[0] else int(t[-1])
