"""Signals and results on their way into the history: gathered, and kept now and then at once."""

import asyncio
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain, pairwise
from typing import Final, NamedTuple

import numpy as np
import structlog
from numpy.typing import NDArray

from valvemap.errors import StorageError
from valvemap.model.samples import Codes, Floats, Samples, Times
from valvemap.pipeline.alignment import ByValve
from valvemap.pipeline.ports import (
    SIGNALS,
    AlarmChange,
    PastCounters,
    PastStore,
    Piece,
    Results,
)
from valvemap.vocabulary.quantities import HISTORY_QUANTITIES
from valvemap.vocabulary.statuses import Quality

REQUIRED_U: Final = "RequiredU"
MOST_ROWS: Final = 1_000_000  # that wait to be kept: 60 MB; more are lost
SERIES_PER_S: Final = 500  # kept in a second, at 0.1 ms each: with more the interval is longer
FORGET_EVERY_S: Final = 60.0
_SIGNALS, _INVERSE = "Signals", "Inverse"

_CODES = np.zeros(max(Quality) + 1, np.uint32)
_CODES[Quality.UNCERTAIN], _CODES[Quality.BAD] = 0x4000_0000, 0x8000_0000

log = structlog.get_logger(__name__)


def signals_of(valve: str) -> str:
    """Name of the series of a valve's signals."""
    return f"{valve}.{_SIGNALS}"


def results_of(valve: str, part: str) -> str:
    """Name of the series of an estimator's results, or of those of the inverse map."""
    return f"{valve}.{part}"


class _Noted(NamedTuple):
    """What is kept of one part's results, of (M,) valves: no more, as they wait for seconds."""

    part: str
    valves: Times
    quality: Codes
    t: Times
    columns: Mapping[str, Floats]


class PastKeeper:
    """Gathers rows and has them kept in a thread: identification waits for neither disk nor lock.

    What is lost by a kill is what was gathered since the last save, a second for up to 100 valves.

    Parameters
    ----------
    store
        Keeps them.
    valves
        Names.

    Attributes
    ----------
    lost : int
        Rows that found no room, or that the disk did not take.
    failures : int
        How often it did not.
    """

    def __init__(self, store: PastStore, valves: Sequence[str]) -> None:
        self._store = store
        self._valves = tuple(valves)
        self._samples: list[ByValve] = []
        self._results: list[_Noted] = []
        self._changes: list[AlarmChange] = []
        self._rows = 0
        self._due = self._forget_due = 0.0
        self._keeping: asyncio.Task[None] | None = None
        self._failed: dict[str, Exception] = {}
        self.lost = self.failures = 0

    def take_failed(self) -> list[tuple[int, Exception]]:
        """Valves whose rows raised an error while they were saved since the last call."""
        failed, self._failed = self._failed, {}
        return [(self._valves.index(name), error) for name, error in failed.items()]

    def take(self, samples: ByValve) -> None:
        """Gather samples."""
        if self._has_room(len(samples.samples)):
            self._samples.append(samples)

    def note(self, results: Results) -> None:
        """Gather results."""
        if self._has_room(len(results.valves) * (len(results.estimators) + 1)):
            self._results += _noted(results)

    def note_alarm(self, change: AlarmChange) -> None:
        """Gather a change of an alarm."""
        if self._has_room(1):
            self._changes.append(change)

    def tick(self, now: float, utc: int) -> None:
        """Have kept what was gathered, if it is time; ``now`` in s, ``utc`` in ns."""
        if now < self._due or (self._keeping is not None and not self._keeping.done()):
            return
        parts = len({noted.part for noted in self._results} | {_SIGNALS})
        self._due = now + max(1.0, len(self._valves) * parts / SERIES_PER_S)
        forget = now >= self._forget_due
        if forget:
            self._forget_due = now + FORGET_EVERY_S
        self._keeping = asyncio.create_task(self._keep(utc if forget else None))

    async def settle(self) -> None:
        """Keep all that was gathered."""
        if self._keeping is not None:
            await self._keeping
        await self._keep(None)

    @property
    def counters(self) -> PastCounters:
        """What was lost, and how large the history is."""
        return PastCounters(self.lost + self._store.lost, self.failures, self._store.size)

    def _has_room(self, rows: int) -> bool:
        if self._rows + rows > MOST_ROWS:
            self.lost += rows
            return False
        self._rows += rows
        return True

    async def _keep(self, forget_at: int | None) -> None:
        samples, results, rows = self._samples, self._results, self._rows
        changes = self._changes
        self._samples, self._results, self._changes, self._rows = [], [], [], 0

        failed: dict[str, Exception] = {}

        def pieces() -> Iterator[Piece]:
            of_samples = _of_samples(self._valves, samples, failed)
            return chain(of_samples, _of_results(self._valves, results, failed))

        def keep() -> None:
            if samples or results:  # piece by piece: all at once would be tens of megabytes
                self._save(pieces, failed)
            if changes:
                self._store.note(changes)
            if forget_at is not None:
                self._store.forget(forget_at)

        try:
            await asyncio.to_thread(keep)
        except StorageError as error:
            self.failures += 1
            self.lost += rows
            log.warning("history not kept", reason=str(error))
        for note in self._store.take_notes():
            log.warning("history damaged", reason=note, lost=self._store.lost)
        self._failed = failed | self._failed

    def _save(self, pieces: Callable[[], Iterator[Piece]], failed: dict[str, Exception]) -> None:
        """Keep all pieces at once, or each alone where one of them raises: the others are kept."""
        try:
            self._store.save(pieces())
        except StorageError:
            raise
        except Exception:  # noqa: BLE001 - a bulkhead: the piece is found next
            for piece in pieces():
                try:
                    self._store.save([piece])
                except StorageError:
                    raise
                except Exception as error:  # noqa: BLE001 - a bulkhead: the others are kept
                    failed[piece.series.rpartition(".")[0]] = error
                    self.lost += len(piece.t)


def _of_samples(
    names: Sequence[str], batches: Sequence[ByValve], failed: dict[str, Exception]
) -> Iterator[Piece]:
    """One piece for each valve, but for those of which none can be made: they are ``failed``."""
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
    columns = {name: np.concatenate([getattr(part, name) for part in samples]) for name in SIGNALS}
    t = np.concatenate([part.t for part in samples])
    quality = np.concatenate([part.quality for part in samples])
    return Piece(signals_of(valve), t, _CODES[quality], columns)


def _noted(results: Results) -> Iterator[_Noted]:
    """Of each estimator, of the inverse map, and of signals that are Bad."""
    valves, inverse, signals = results.valves, results.inverse, results.signals
    for name, found in results.estimators.items():
        columns = {q.name: getattr(found, q.field) for q in HISTORY_QUANTITIES}
        yield _Noted(name, valves, found.quality, found.t, columns)
    yield _Noted(_INVERSE, valves, inverse.quality, inverse.t, {REQUIRED_U: inverse.required_U})
    if signals is not None:
        lost = signals.quality == Quality.BAD
        columns = dict(zip(SIGNALS, signals.values[lost].T, strict=True))
        yield _Noted(_SIGNALS, valves[lost], signals.quality[lost], signals.t[lost], columns)


def _of_results(
    names: Sequence[str], noted: Sequence[_Noted], failed: dict[str, Exception]
) -> Iterator[Piece]:
    """One piece for each part of each valve.

    Results that are Bad have no sample of their own: they are noted right behind the last.
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


def _codes(quality: Codes) -> NDArray[np.uint32]:
    return np.asarray(_CODES[quality])
