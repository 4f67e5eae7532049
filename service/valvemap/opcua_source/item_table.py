"""What the data changes of each item show: type, status, rate, moves of the value. Pure."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from asyncua import ua
from numpy.typing import NDArray

from valvemap.opcua_source.wire import NUMERIC_FORMATS
from valvemap.pipeline.data_changes import DataChanges
from valvemap.vocabulary.signals import PER_VALVE, Signal

NEVER: Final = -np.inf
QUIET_S: Final = 2.0  # s; without a change for longer, the node is read
_STILL_S: Final = 3.0  # s; a shorter time without a new value means nothing
_STILL_SAMPLES: Final = 20  # samples of the valve, likewise
_STILL_TIMES: Final = 5  # times the longest such run of samples before
_KNOWN_MOVES: Final = 20  # messages with a new value, before rest means something
_OFF_PACE: Final = 1.5  # ratio of a changed sampling period to the usual one
_REGULAR: Final = 20  # messages with the usual period, after which another one is a change
_CHANGED: Final = 3  # messages in a row with another period
_SETTLED: Final = 60  # … after which it is the usual one
_WEIGHT: Final = 0.1  # of a new period in the usual one
_BOOLEAN: Final = int(ua.VariantType.Boolean.value)
_NO_VALUE: Final = 0


@dataclass(frozen=True)
class Pace:
    """Sampling periods of one item, s: the present one and the usual one before."""

    now_s: float
    usual_s: float


class ItemTable:
    """The newest change of each item, and its usual interval; arrays over all items of a source.

    Parameters
    ----------
    valves
        Number of valves; each has PER_VALVE items.

    Attributes
    ----------
    heard : float64
        Receipt of the newest change, monotonic, s.
    time, status, kind
        Source time (UTC ns), StatusCode and built-in type of the newest change; type 0: no value,
        255: no numeric scalar.

    Examples
    --------
    >>> table = ItemTable(1)
    >>> changes = DataChanges(
    ...     np.array([1], np.int32), np.ones(1), np.zeros(1, np.uint32), np.array([10])
    ... )
    >>> _ = table.note(changes, np.array([255], np.uint8), now=5.0)
    >>> table.suspects(now=5.0).tolist()
    [True, True, True, True, True, True]
    """

    def __init__(self, valves: int) -> None:
        items = valves * PER_VALVE
        self.heard = np.full(items, NEVER)
        self.time = np.zeros(items, np.int64)
        self.status = np.zeros(items, np.uint32)
        self.kind = np.zeros(items, np.uint8)
        self.takes_booleans = np.zeros(items, np.bool_)
        self._value = np.full(items, np.nan)
        self._moved = np.full(items, NEVER)
        self._moves = np.zeros(items, np.int64)
        self._samples = np.zeros(valves, np.int64)  # of each valve's fastest signal
        self._moved_at = np.zeros(items, np.int64)  # … at the last move
        self._longest_rest = np.zeros(items, np.int64)
        self._period = np.zeros(items)
        self._usual = np.zeros(items)
        self._regular = np.zeros(items, np.int64)
        self._changed = np.zeros(items, np.int64)

    def note(self, changes: DataChanges, kind: NDArray[np.uint8], now: float) -> DataChanges:
        """Note changes, (N,), received at ``now``; return them, unexpected Booleans as NaN."""
        item = changes.item
        known = (item >= 0) & (item < len(self.heard))
        if not known.all():
            changes, kind, item = changes[known], kind[known], item[known]
        if not len(item):
            return changes
        wrong = (kind == _BOOLEAN) & ~self.takes_booleans[item]
        if wrong.any():
            changes = replace(changes, value=np.where(wrong, np.nan, changes.value))
        last = np.full(len(self.heard), -1)
        last[item] = np.arange(len(item))
        own = np.flatnonzero(last >= 0)
        newest = last[own]
        moves = np.zeros(len(self.heard), np.bool_)
        moves[item[changes.value != self._value[item]]] = True
        count = np.bincount(item, minlength=len(last))
        self._note_moves(own[moves[own]], now)
        self._samples += count.reshape(-1, PER_VALVE).max(axis=1)
        self._note_pace(own, count[own], changes, newest)
        self._value[own], self.status[own] = changes.value[newest], changes.status[newest]
        self.kind[own], self.time[own] = kind[newest], changes.source_time[newest]
        self.heard[own] = now
        return changes

    def suspects(self, now: float) -> NDArray[np.bool_]:
        """Mask of the items whose node should be read: silent, Bad, or without a number."""
        return (now - self.heard > QUIET_S) | (self.status >> 31 > 0) | ~self.is_number

    @property
    def is_number(self) -> NDArray[np.bool_]:
        """Mask of the items whose newest value was a number of a permitted type, or none yet."""
        numbers = np.isin(self.kind, [_NO_VALUE, *NUMERIC_FORMATS])
        return numbers & ((self.kind != _BOOLEAN) | self.takes_booleans)

    def still(self, now: float) -> NDArray[np.bool_]:
        """Mask of the items whose value moved steadily before and rests, while others move.

        Rest is counted in samples of the valve, so no clock and no stall looks like it. U may rest,
        and the running number is judged by the alignment.
        """
        recent = now - self._moved < QUIET_S
        recent[Signal.SEQUENCE :: PER_VALVE] = False
        others = np.repeat(recent.reshape(-1, PER_VALVE).any(axis=1), PER_VALVE)
        limit = np.maximum(_STILL_SAMPLES, _STILL_TIMES * self._longest_rest)
        still = (self._rest() > limit) & (now - self._moved > _STILL_S) & others
        still &= self._moves >= _KNOWN_MOVES
        still[Signal.U :: PER_VALVE] = still[Signal.SEQUENCE :: PER_VALVE] = False
        return still

    def rest(self, item: int) -> tuple[int, int]:
        """Return for how many samples a value rests, and the longest rest before."""
        return int(self._rest()[item]), int(self._longest_rest[item])

    def _rest(self) -> NDArray[np.int64]:
        return np.repeat(self._samples, PER_VALVE) - self._moved_at

    def slower(self) -> NDArray[np.bool_]:
        """Mask of the items whose sampling period is longer than usual."""
        return (self._changed >= _CHANGED) & (self._period > self._usual)

    def pace(self, item: int) -> Pace:
        """Return the present and the usual sampling period."""
        return Pace(float(self._period[item]), float(self._usual[item]))

    def forget(self, item: int) -> None:
        """Reset the usual interval: the node was created again."""
        self.heard[item] = NEVER
        self.status[item], self.kind[item] = 0, _NO_VALUE
        self._moves[item] = self._longest_rest[item] = 0
        self._usual[item] = self._regular[item] = self._changed[item] = 0

    def _note_moves(self, moving: NDArray[np.intp], now: float) -> None:
        rest = self._rest()[moving]
        known = self._moves[moving] > 0
        self._longest_rest[moving] = np.maximum(
            self._longest_rest[moving], np.where(known, rest, 0)
        )
        self._moved_at[moving] = self._samples[moving // PER_VALVE]
        self._moved[moving] = now
        self._moves[moving] += 1

    def _note_pace(
        self,
        own: NDArray[np.intp],
        count: NDArray[np.int64],
        changes: DataChanges,
        newest: NDArray[np.int64],
    ) -> None:
        """Compare the mean period of a message, by source time, with the usual one."""
        passed = (changes.source_time[newest] - self.time[own]) * 1e-9
        usable = (self.time[own] > 0) & (passed > 0.0)
        own, period = own[usable], passed[usable] / count[usable]
        usual = self._usual[own]
        ratio = np.divide(period, usual, out=np.ones_like(period), where=usual > 0.0)
        alike = (ratio < _OFF_PACE) & (ratio > 1.0 / _OFF_PACE)
        settled = self._changed[own] >= _SETTLED
        restart = (usual == 0.0) | settled | (~alike & (self._regular[own] < _REGULAR))
        mean = usual + _WEIGHT * (period - usual)
        self._usual[own] = np.where(restart, period, np.where(alike, mean, usual))
        self._regular[own] = np.where(restart, 0, self._regular[own] + alike)
        self._changed[own] = np.where(alike | restart, 0, self._changed[own] + 1)
        self._period[own] = period
