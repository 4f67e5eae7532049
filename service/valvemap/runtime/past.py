"""Buffers signals and results for the history, and saves them at intervals."""

import asyncio
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain, pairwise
from typing import Any, Final, NamedTuple

import numpy as np
import structlog
from numpy.typing import NDArray

from valvemap.errors import StorageError
from valvemap.model.samples import Codes, Floats, Samples, Times
from valvemap.pipeline.alignment import ByValve
from valvemap.pipeline.axis_ports import AxisResults
from valvemap.pipeline.result_ports import PastCounters
from valvemap.pipeline.results import AlarmChange, Results
from valvemap.pipeline.store_ports import PastStore, Piece
from valvemap.vocabulary.history_columns import REQUIRED_U, REQUIRED_U_STATUS, STATUS
from valvemap.vocabulary.quantities import HISTORY_QUANTITIES
from valvemap.vocabulary.signals import PUBLISHED
from valvemap.vocabulary.statuses import Quality

MOST_ROWS: Final = 1_000_000  # rows buffered: 60 MB; further rows are dropped and counted
SERIES_PER_S: Final = 500  # series saved per s, 0.1 ms each; more series lengthen the interval
FORGET_EVERY_S: Final = 60.0
_SIGNALS, _INVERSE = "Signals", "Inverse"

_CODES = np.zeros(max(Quality) + 1, np.uint32)
_CODES[Quality.UNCERTAIN], _CODES[Quality.BAD] = 0x4000_0000, 0x8000_0000

log = structlog.get_logger(__name__)


def signals_of(valve: str) -> str:
    """Return the series name of a valve's signals."""
    return f"{valve}.{_SIGNALS}"


def results_of(valve: str, part: str) -> str:
    """Return the series name of results of an estimator or inverse map, or of an axis' status."""
    return f"{valve}.{part}"


class _Noted(NamedTuple):
    """Buffered results of one part (an estimator, the inverse map, signals) for (M,) valves."""

    part: str
    valves: Times
    quality: Codes
    t: Times
    columns: Mapping[str, Floats]


class PastKeeper:
    """Buffers rows and saves them in a thread: identification waits for neither disk nor lock.

    A kill loses the rows since the last save: one second for up to 100 valves. If a save fails, as
    on a full disk, its rows wait in the buffer for the next one.

    Parameters
    ----------
    store
        The history.
    valves
        Names.

    Attributes
    ----------
    lost : int
        Rows dropped because the buffer was full, or could not be saved at the end.
    failures : int
        Saves that failed.
    """

    def __init__(self, store: PastStore, valves: Sequence[str]) -> None:
        self._store = store
        self._valves = tuple(valves)
        self._samples: list[ByValve] = []
        self._results: list[_Noted] = []
        self._changes: list[AlarmChange] = []
        self._of_axes: list[Piece] = []
        self._rows = 0
        self._due = self._forget_due = 0.0
        self._keeping: asyncio.Task[None] | None = None
        self._failed: dict[str, Exception] = {}
        self.lost = self.failures = 0
        self._failing_since = math.nan  # monotonic s, as of `tick`
        self._now = 0.0
        self._lost_before = store.lost

    def take_failed(self) -> list[tuple[int, Exception]]:
        """Return the valves whose rows raised an error in saving since the last call."""
        failed, self._failed = self._failed, {}
        known = [(name, error) for name, error in failed.items() if name in self._valves]
        return [(self._valves.index(name), error) for name, error in known]

    def take(self, samples: ByValve) -> None:
        """Buffer samples."""
        if self._has_room(len(samples.samples)):
            self._samples.append(samples)

    def note(self, results: Results) -> None:
        """Buffer results."""
        noted = list(_noted(results))
        if self._has_room(sum(len(one.valves) for one in noted)):
            self._results += noted

    def note_axis(self, pieces: Sequence[Piece]) -> None:
        """Buffer rows of an axis."""
        if self._has_room(sum(len(piece.t) for piece in pieces)):
            self._of_axes += pieces

    def note_alarm(self, change: AlarmChange) -> None:
        """Buffer a change of an alarm."""
        if self._has_room(1):
            self._changes.append(change)

    def tick(self, now: float) -> None:
        """Start a save of the buffer if one is due; ``now`` in s."""
        self._now = now
        if now < self._due or (self._keeping is not None and not self._keeping.done()):
            return
        parts = len({noted.part for noted in self._results} | {_SIGNALS})
        self._due = now + max(1.0, len(self._valves) * parts / SERIES_PER_S)
        forget = now >= self._forget_due
        if forget:
            self._forget_due = now + FORGET_EVERY_S
        self._keeping = asyncio.create_task(self._keep(forget=forget))

    def waits_s(self, now: float) -> float:
        """Time for which saves have failed, s; ∞ once after rows were lost."""
        lost, self._lost_before = self.counters.lost > self._lost_before, self.counters.lost
        if lost:
            return math.inf
        return 0.0 if math.isnan(self._failing_since) else now - self._failing_since

    async def settle(self) -> bool:
        """Save the whole buffer; return whether no row waits any more."""
        if self._keeping is not None:
            await self._keeping
        await self._keep()
        return self._rows == 0

    async def end(self) -> None:
        """Save the whole buffer; rows that cannot be saved are lost."""
        if not await self.settle():
            log.error("history rows lost at the end", rows=self._rows)
            self.lost += self._rows
            self._samples, self._results, self._changes, self._rows = [], [], [], 0
            self._of_axes = []

    @property
    def counters(self) -> PastCounters:
        """Lost rows, failed saves, and the size of the history."""
        return PastCounters(self.lost + self._store.lost, self.failures, self._store.size)

    def _has_room(self, rows: int) -> bool:
        if self._rows + rows > MOST_ROWS:
            self.lost += rows
            return False
        self._rows += rows
        return True

    async def _keep(self, *, forget: bool = False) -> None:
        samples, results, rows = self._samples, self._results, self._rows
        changes, of_axes = self._changes, self._of_axes
        self._samples, self._results, self._changes, self._of_axes = [], [], [], []

        failed: dict[str, Exception] = {}

        def pieces() -> Iterator[Piece]:
            of_samples = _of_samples(self._valves, samples, failed)
            return chain(of_samples, _of_results(self._valves, results, failed), joined(of_axes))

        def keep() -> None:
            if samples or results or of_axes:
                self._save(pieces, failed)  # piece by piece: all at once would be tens of megabytes
            if changes:
                self._store.note(changes)
            if forget:
                self._store.forget()

        try:
            await asyncio.to_thread(keep)
            self._rows -= rows  # until then they need their room: they return if refused
            self._failing_since = math.nan
        except StorageError as error:
            self.failures += 1
            if math.isnan(self._failing_since):
                self._failing_since = self._now
            self._samples, self._results = samples + self._samples, results + self._results
            self._changes, self._of_axes = changes + self._changes, of_axes + self._of_axes
            log.warning(
                "history not kept, its rows wait", reason=str(error), rows=self._rows, of=MOST_ROWS
            )
        for note in self._store.take_notes():
            log.warning("history damaged", reason=note, lost=self._store.lost)
        self._failed = failed | self._failed

    def _save(self, pieces: Callable[[], Iterator[Piece]], failed: dict[str, Exception]) -> None:
        """Save all pieces together; if one raises, save each alone and skip those that fail."""
        try:
            self._store.save(pieces())
        except StorageError:
            raise
        except Exception:  # noqa: BLE001 - a bulkhead: the failing piece is found next
            for piece in pieces():
                try:
                    self._store.save([piece])
                except StorageError:
                    raise
                except Exception as error:  # noqa: BLE001 - a bulkhead: the others are kept
                    failed[piece.series.rpartition(".")[0]] = error
                    self.lost += len(piece.t)


def pieces_of(axis: str, results: AxisResults, *, with_map: bool) -> list[Piece]:
    """Return the rows of an axis: status, answer to a demand, and ``with_map`` its quantities.

    While it is stale, it has no sample: the time is that of the last sample plus 1 ns.
    """
    quality = Quality.UNCERTAIN if results.is_stale else Quality.GOOD
    t, good = np.array([results.t]), _CODES[[Quality.GOOD]]
    status = {STATUS: np.array([float(results.status)])}
    pieces = [Piece(results_of(axis, STATUS), t + results.is_stale, good, status)]
    if with_map:
        columns = {name: np.array([value]) for name, value in results.numbers.items()}
        pieces.append(Piece(axis, t, _CODES[[quality]], columns))
    if np.isfinite(results.required.U):
        answer = {
            REQUIRED_U: np.array([results.required.U]),
            REQUIRED_U_STATUS: np.array([float(results.required.status)]),
        }
        pieces.append(Piece(results_of(axis, _INVERSE), t, good, answer))
    return pieces


def joined(pieces: Sequence[Piece]) -> Iterator[Piece]:
    """Yield one piece for each series, of pieces with the same columns."""
    by_series: dict[str, list[Piece]] = {}
    for piece in pieces:
        by_series.setdefault(piece.series, []).append(piece)
    for series, own in by_series.items():
        columns = {
            name: np.concatenate([one.columns[name] for one in own]) for name in own[0].columns
        }
        codes = np.concatenate([one.codes for one in own])
        yield Piece(series, np.concatenate([one.t for one in own]), codes, columns)


def _of_samples(
    names: Sequence[str], batches: Sequence[ByValve], failed: dict[str, Exception]
) -> Iterator[Piece]:
    """Yield one piece for each valve; valves whose piece raises are added to ``failed``."""
    by_valve: dict[int, list[ByValve]] = {}
    for batch in batches:
        for valve in batch:
            by_valve.setdefault(valve, []).append(batch)
    for valve, own in by_valve.items():
        try:
            piece = _signals(names[valve], [batch[valve] for batch in own])
        except Exception as error:  # noqa: BLE001 - a bulkhead: the others are kept
            failed[names[valve]] = error
        else:
            yield piece


def _signals(valve: str, samples: Sequence[Samples]) -> Piece:
    columns = {
        name: np.concatenate([getattr(part, name) for part in samples]) for name in PUBLISHED
    }
    t = np.concatenate([part.t for part in samples])
    quality = np.concatenate([part.quality for part in samples])
    return Piece(signals_of(valve), t, _CODES[quality], columns)


def _noted(results: Results) -> Iterator[_Noted]:
    """Yield the rows of each estimator, of the inverse map, and of signals that are Bad."""
    valves, inverse, signals = results.valves, results.inverse, results.signals
    for name, found in results.estimators.items():
        columns = {q.name: _numbers(getattr(found, q.field)) for q in HISTORY_QUANTITIES}
        yield _Noted(name, valves, found.quality, found.t, columns)
    answer = {REQUIRED_U: inverse.required_U, REQUIRED_U_STATUS: _numbers(inverse.status)}
    yield _Noted(_INVERSE, valves, inverse.quality, inverse.t, answer)
    if signals is not None:
        lost = signals.quality == Quality.BAD
        columns = dict(zip(PUBLISHED, signals.values[lost].T, strict=True))
        yield _Noted(_SIGNALS, valves[lost], signals.quality[lost], signals.t[lost], columns)


def _of_results(
    names: Sequence[str], noted: Sequence[_Noted], failed: dict[str, Exception]
) -> Iterator[Piece]:
    """Yield one piece for each part of each valve.

    Bad results have no sample: their time is that of the last sample plus 1 ns.
    """
    by_part: dict[str, list[_Noted]] = {}
    for one in noted:
        by_part.setdefault(one.part, []).append(one)
    for part, rows in by_part.items():
        yield from _by_valve(names, part, rows, failed)


def _by_valve(
    names: Sequence[str], part: str, rows: Sequence[_Noted], failed: dict[str, Exception]
) -> Iterator[Piece]:
    valves = np.concatenate([row.valves for row in rows])
    quality = np.concatenate([row.quality for row in rows])
    t = np.concatenate([row.t for row in rows])
    columns = {
        name: np.concatenate([row.columns[name] for row in rows]) for name in rows[0].columns
    }
    t = np.where(quality == Quality.BAD, t + 1, t)
    order = np.argsort(valves, kind="stable")
    order = order[t[order] > 1]  # no sample yet
    edges = np.flatnonzero(np.diff(valves[order], prepend=-1, append=-1))
    for first, last in pairwise(edges.tolist()):
        own, name = order[first:last], names[int(valves[order[first]])]
        try:
            of_valve = {column: values[own] for column, values in columns.items()}
            piece = Piece(results_of(name, part), t[own], _codes(quality[own]), of_valve)
        except Exception as error:  # noqa: BLE001 - a bulkhead: the others are kept
            failed[name] = error
        else:
            yield piece


def _numbers(values: NDArray[Any]) -> Floats:
    return np.asarray(values, np.float64)


def _codes(quality: Codes) -> NDArray[np.uint32]:
    return np.asarray(_CODES[quality])
