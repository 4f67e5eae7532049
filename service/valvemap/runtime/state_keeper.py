"""Saves checkpoints in turns, each valve once per interval, with the source's position."""

import asyncio
import math
from collections.abc import Sequence
from typing import Any

import structlog

from valvemap.clock import Clock
from valvemap.errors import StateFileLost, StorageError
from valvemap.pipeline.kept_together import KeptTogether
from valvemap.pipeline.source_ports import AllSources
from valvemap.pipeline.store_ports import Checkpoint, CheckpointStore
from valvemap.runtime.kept_position import position_of

KEPT_PER_S = 20  # valves saved per s, 3 MB, unless more are due
KEPT_AT_ONCE = 64  # valves per save at most, 10 MB: longest that a shutdown waits for
PACKED_AT_ONCE = 16  # valves packed, 1 ms each, between yields to the event loop

log = structlog.get_logger(__name__)


class StateKeeper:
    """Packs states a few valves, or axes, at a time and saves them in a thread.

    Valves whose samples meet, as behind one meter, are a unit: they are packed and saved together,
    so that a restart continues with all of them at the same sample. A unit is not packed again
    while nothing has changed since its last save; the save itself then only checks the file.

    Implements `KeptElsewhere`: of two keepers, the other's counters and age are shown with one's.

    Parameters
    ----------
    states
        The states, each valve's or axis' packed at once.
    source
        Provides its position, and receives a commit once the states are saved.
    store
        The checkpoint store.
    clock
        Time of the turns.
    interval_s
        Longest interval between saves of a state; with few valves, one second.

    Attributes
    ----------
    mark
        The source's mark after the last estimated changes.
    kept_at : float
        Time of the last save, monotonic s; NaN before the first.
    failures : int
        Saves that failed.
    refused : int
        States that were not restored at the start.
    """

    def __init__(
        self,
        states: KeptTogether,
        source: AllSources,
        store: CheckpointStore,
        clock: Clock,
        interval_s: float,
    ) -> None:
        self.mark: Any = None
        self.kept_at = math.nan
        self.failures = self.refused = 0
        self._file_lost = False
        self._states = states
        self._source = source
        self._store = store
        self._clock = clock
        self._units = states.units
        self._saved: dict[int, tuple[int, ...]] = {}  # by a unit's first number: its version
        self._valves = sum(map(len, self._units))
        self._interval_s = min(interval_s, max(1.0, self._valves / KEPT_PER_S))
        self._began, self._turns = clock.monotonic(), 0  # turns completed, saved or refused
        self._next = 0  # the unit saved longest ago: units are saved in their order
        self._left_in_round = 0  # valves not yet saved in this round
        self._mark_of_round: Any = None  # the mark at the start of this round
        self._keeping: asyncio.Task[None] | None = None
        self._packing_s = self._saving_s = 0.0  # last durations: packing one valve, one save

    def age_s(self, now: float) -> float:
        """Time since the last save, s; before the first, since the start.

        0 in a preview, and without valves; once ∞ after the file was removed or replaced.
        """
        lost, self._file_lost = self._file_lost, False
        if self._states.is_preview or not self._valves:
            return 0.0
        if lost:
            return math.inf
        return now - (self._began if math.isnan(self.kept_at) else self.kept_at)

    async def settle(self) -> None:
        """Wait for the save in progress."""
        if self._keeping is not None:
            await self._keeping

    def states(self) -> list[Checkpoint]:
        """Return all states, packed now."""
        return self._states_of([number for unit in self._units for number in unit])

    async def keep(self, until: float = math.inf) -> bool:
        """Save all states, oldest save first, as far as the time ``until`` permits.

        Returns False if not all were saved. The others keep their previous checkpoints, and the
        source resends the changes since.

        Raises
        ------
        StorageError
            naming the file; the states remain in memory.
        """
        await self.settle()
        if self._states.is_preview:
            return True
        try:
            return await self._keep_all(until)
        except StateFileLost as error:
            self._begin_again(error)
            return await self._keep_all(until)

    async def _keep_all(self, until: float) -> bool:
        at_once = self._valves if math.isinf(until) else KEPT_AT_ONCE
        saved = 0  # units
        while saved < len(self._units):
            some = self._oldest(at_once, saved)
            packing_s = sum(map(len, some)) * self._packing_s
            if self._clock.monotonic() + packing_s + self._saving_s > until:
                return False
            states = await self._packed(some)
            saved += len(some)
            if saved == len(self._units):
                states += position_of(self._source, self.mark, self._clock)
            began = self._clock.monotonic()
            await asyncio.to_thread(self._store.save, states)
            self._saving_s = self._clock.monotonic() - began
        return True

    def keep_in_turn(self, now: float) -> None:
        """Start to save the valves that are due, a few at a time: no batch waits for all.

        A round saves every valve once, and then the mark of its beginning. A valve leaves the
        round when it is saved: a refused save is repeated, so the mark is never ahead of a state.
        """
        if self._states.is_preview or (self._keeping is not None and not self._keeping.done()):
            return
        M = self._valves
        due = int(M * (now - self._began) / self._interval_s)
        count = min(due - self._turns, M, KEPT_AT_ONCE)
        if count <= 0:
            return
        some = self._oldest(count)
        count = sum(map(len, some))
        self._turns = due if M <= KEPT_AT_ONCE else self._turns + count
        if not self._left_in_round:
            self._left_in_round, self._mark_of_round = M, self.mark
        mark = self._mark_of_round if count >= self._left_in_round else None
        self._keeping = asyncio.create_task(self._keep(some, mark))

    def _oldest(self, count: int, skip: int = 0) -> list[Sequence[int]]:
        """Return units of at least ``count`` valves, if there are, behind the first ``skip``."""
        found: list[Sequence[int]] = []
        for place in range(self._next + skip, self._next + len(self._units)):
            if sum(map(len, found)) >= count:
                break
            found.append(self._units[place % len(self._units)])
        return found

    async def _keep(self, units: Sequence[Sequence[int]], mark: Any) -> None:  # noqa: ANN401
        """Save these units; a refused save is counted and logged, and delays no batch."""
        version = self._states.version
        changed = [unit for unit in units if self._saved.get(unit[0]) != version]
        try:
            states = [*await self._packed(changed), *position_of(self._source, mark, self._clock)]
            began = self._clock.monotonic()
            await asyncio.to_thread(self._store.save, states)
        except StateFileLost as error:
            self._begin_again(error)
            return
        except StorageError as error:
            self.failures += 1
            log.warning("checkpoint not saved", reason=str(error))
            return
        self._saved |= {unit[0]: version for unit in changed}
        self.kept_at = self._clock.monotonic()
        self._saving_s = self.kept_at - began
        self._next = (self._next + len(units)) % len(self._units)
        self._left_in_round = max(self._left_in_round - sum(map(len, units)), 0)
        if mark is not None:
            self._source.commit(mark)

    def _begin_again(self, error: StateFileLost) -> None:
        """Begin a new round: the new file has no state, and no mark may be ahead of one."""
        self.failures += 1
        self._file_lost = True
        self._saved.clear()
        self._left_in_round = 0
        self._turns -= self._valves  # all are due
        log.error("state file lost", reason=str(error))

    async def _packed(self, units: Sequence[Sequence[int]]) -> list[Checkpoint]:
        """Pack states into bytes, a few valves at a time, yielding to the event loop after each.

        A unit is packed at once: an instant later its samples would not meet.
        """
        packed: list[Checkpoint] = []
        some: list[int] = []
        for last, unit in enumerate(units, 1):
            some += unit
            if len(some) >= PACKED_AT_ONCE or last == len(units):
                began = self._clock.monotonic()
                packed += self._states_of(some)
                self._packing_s = (self._clock.monotonic() - began) / len(some)
                some = []
                await asyncio.sleep(0)
        if not units:
            await asyncio.sleep(0)
        return packed

    def _states_of(self, valves: Sequence[int]) -> list[Checkpoint]:
        """Pack the valves together, or one by one if that raises; stop the one that fails."""
        try:
            return self._states.kept(valves)
        except Exception as error:  # noqa: BLE001 - a bulkhead: the others are kept
            if len(valves) == 1:
                self._states.stop(valves[0], error)
                return []
        return [one for valve in valves for one in self._states_of([valve])]
