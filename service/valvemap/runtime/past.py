"""Buffers signals and results for the history, and saves them at intervals."""

import asyncio
import math
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from typing import Final

import structlog

from valvemap.errors import StorageError
from valvemap.pipeline.alarm_results import AlarmChange
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.result_ports import PastCounters
from valvemap.pipeline.results import Results
from valvemap.pipeline.store_ports import PastStore, Piece
from valvemap.runtime.past_pieces import (
    SIGNALS,
    PartResults,
    joined,
    parts_of,
    rows_of_results,
    rows_of_samples,
)

MOST_ROWS: Final = 1_000_000  # rows buffered: 60 MB; further rows are dropped and counted
SERIES_PER_S: Final = 500  # series saved per s, 0.1 ms each; more series lengthen the interval
FORGET_EVERY_S: Final = 60.0

log = structlog.get_logger(__name__)


class PastKeeper:
    """Buffers rows and saves them in a thread: identification waits for neither disk nor lock.

    A kill loses the rows since the last save: one second for up to 100 valves. If a save fails, as
    on a full disk, its rows wait in the buffer for the next one, also over a reload.

    Parameters
    ----------
    store
        The history.
    valves
        Names, until `follow`.

    Attributes
    ----------
    lost : int
        Rows dropped because the buffer was full, or could not be saved at the end.
    failures : int
        Saves that failed.
    """

    def __init__(self, store: PastStore, valves: Sequence[str] = ()) -> None:
        self._store = store
        self._valves = tuple(valves)
        self._samples: list[ByValve] = []
        self._results: list[PartResults] = []
        self._changes: list[AlarmChange] = []
        self._named: list[Piece] = []  # of axes, and of valves before the last reload
        self._rows = 0
        self._due = self._forget_due = 0.0
        self._keeping: asyncio.Task[None] | None = None
        self._failed: dict[str, Exception] = {}
        self.lost = self.failures = 0
        self._failing_since = math.nan  # monotonic s, as of `tick`
        self._now = 0.0
        self._lost_before = store.lost

    async def follow(self, valves: Sequence[str]) -> None:
        """Buffer rows of these valves from now on; those that wait keep the names they came under.

        Call it between the last `take` or `note` of the former valves and the first of these.
        """
        if self._keeping is not None:
            await self._keeping
        self._named = list(self._pieces(self._samples, self._results, self._named, self._failed))
        self._samples, self._results = [], []
        self._rows = sum(len(piece.t) for piece in self._named) + len(self._changes)
        self._valves = tuple(valves)

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
        noted = list(parts_of(results))
        if self._has_room(sum(len(one.valves) for one in noted)):
            self._results += noted

    def note_axis(self, pieces: Sequence[Piece]) -> None:
        """Buffer rows of an axis."""
        if self._has_room(sum(len(piece.t) for piece in pieces)):
            self._named += pieces

    def note_alarm(self, change: AlarmChange) -> None:
        """Buffer a change of an alarm."""
        if self._has_room(1):
            self._changes.append(change)

    def tick(self, now: float) -> None:
        """Start a save of the buffer if one is due; ``now`` in s."""
        self._now = now
        if now < self._due or (self._keeping is not None and not self._keeping.done()):
            return
        parts = len({noted.part for noted in self._results} | {SIGNALS})
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

    def end(self) -> None:
        """Count the rows that wait as lost: they are not saved any more."""
        if self._rows:
            log.error("history rows lost at the end", rows=self._rows)
        self.lost += self._rows
        self._samples, self._results, self._named, self._changes = [], [], [], []
        self._rows = 0

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
        changes, named = self._changes, self._named
        self._samples, self._results, self._changes, self._named = [], [], [], []

        failed: dict[str, Exception] = {}

        def pieces() -> Iterator[Piece]:
            return self._pieces(samples, results, named, failed)

        def keep() -> None:
            if samples or results or named:
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
            self._changes, self._named = changes + self._changes, named + self._named
            log.warning(
                "history not saved, its rows are buffered",
                reason=str(error),
                rows=self._rows,
                of=MOST_ROWS,
            )
        for note in self._store.take_notes():
            log.warning("history damaged", reason=note, lost=self._store.lost)
        self._failed = failed | self._failed

    def _pieces(
        self,
        samples: Sequence[ByValve],
        results: Sequence[PartResults],
        named: Sequence[Piece],
        failed: dict[str, Exception],
    ) -> Iterator[Piece]:
        return chain(
            joined(named),
            rows_of_samples(self._valves, samples, failed),
            rows_of_results(self._valves, results, failed),
        )

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
