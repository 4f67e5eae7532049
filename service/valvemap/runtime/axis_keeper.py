"""Saves the states of axes with the source's position, restores them, and counts refused saves."""

import asyncio
import math
from collections.abc import Mapping, Sequence
from typing import Any

import structlog

from valvemap.clock import Clock
from valvemap.errors import StateFileLost, StorageError
from valvemap.model.estimator import StateMismatchError
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.axes import ALARMS, LEARNT, WATCH, Axis
from valvemap.pipeline.axis_memory import MEMORIES, MEMORY, AxisMemories
from valvemap.pipeline.source_ports import AllSources
from valvemap.pipeline.store_ports import Checkpoint, CheckpointStore
from valvemap.runtime.kept_position import position_of, resume_source
from valvemap.runtime.state_keeper import KEPT_PER_S

log = structlog.get_logger(__name__)


class AxisKeeper:
    """Implements `KeptElsewhere`: the alarm Checkpoint and the service's counters include it.

    All states and the position of the source are one save, so the position is that of the states.

    Parameters
    ----------
    axes
        The axes.
    arrivals
        Their lines' arrivals, rows 2k and 2k + 1 for axis k.
    source
        Provides its position, and receives a commit once the states are saved.
    store
        Where their states are.
    clock
        Time of the saves.
    interval_s
        Longest time between two saves; with few axes, one second.

    Attributes
    ----------
    mark
        The source's mark after the last changes that the axes took.
    failures : int
        Saves that failed.
    """

    def __init__(
        self,
        axes: Sequence[Axis],
        arrivals: Arrivals,
        source: AllSources,
        store: CheckpointStore,
        clock: Clock,
        interval_s: float,
    ) -> None:
        self.mark: Any = None
        self.failures = 0
        self._axes, self._source, self._store, self._clock = axes, source, store, clock
        self._memories = AxisMemories(arrivals, {k: axis.key for k, axis in enumerate(axes)})
        self._interval_s = min(interval_s, max(1.0, len(axes) / KEPT_PER_S))
        self._kept_at = clock.monotonic()
        self._due = self._kept_at + self._interval_s
        self._file_lost = False
        self._keeping: asyncio.Task[None] | None = None

    def age_s(self, now: float) -> float:
        """Time since the last save, s; before the first, since the start; ∞: the file was lost."""
        lost, self._file_lost = self._file_lost, False
        return math.inf if lost else now - self._kept_at

    def restore(self) -> None:
        """Restore the stored states, and resume the source where they end.

        A state that does not fit is set aside, with its reason.

        Raises
        ------
        StorageError
            if states cannot be set aside: the next save would replace them.
        """
        stored, lost_place = resume_source(self._source, self._store.load())
        for why in lost_place.values():
            log.warning("position of axes left aside", why=why)
        aside: list[tuple[Checkpoint, str]] = []
        for number, axis in enumerate(self._axes):
            own = {one.estimator: one for one in stored if one.valve == axis.plan.name}
            for name in (LEARNT, WATCH, ALARMS):
                if name in own:
                    try:
                        axis.resume(name, own[name].state)
                    except StateMismatchError as error:
                        aside.append((own[name], str(error)))
            beside = {name: one.state for name, one in own.items() if name in MEMORIES}
            try:
                self._remember(number, beside)
            except StateMismatchError as error:
                aside.append((own[MEMORY], str(error)))
        for one, why in aside:
            log.warning("axis starts afresh", axis=one.valve, state=one.estimator, why=why)
        self._store.put_aside(aside, {})

    def _remember(self, number: int, stored: Mapping[str, bytes]) -> None:
        memory = self._memories.restored(number, stored)
        if memory is not None:
            self._axes[number].remember(memory)

    def keep_if_due(self) -> None:
        """Start to save the states once per interval, unless a save is under way."""
        now = self._clock.monotonic()
        if now >= self._due and (self._keeping is None or self._keeping.done()):
            self._due = now + self._interval_s
            self._keeping = asyncio.create_task(self._keep())

    async def settle(self) -> None:
        """Wait for the save in progress."""
        if self._keeping is not None:
            await self._keeping

    async def keep(self) -> None:
        """Save the states; a refused save is counted and logged. A lost file is made anew."""
        await self.settle()
        await self._keep()
        if self._file_lost:
            await self._keep()

    async def _keep(self) -> None:
        """Save the states; the next save tries again what is refused.

        They are packed at once: a job's outcome must not change one halfway.
        """
        mark, kept = self.mark, self._packed()
        kept += position_of(self._source, mark, self._clock)
        try:
            await asyncio.to_thread(self._store.save, kept)
        except StorageError as error:
            self.failures += 1
            self._file_lost = isinstance(error, StateFileLost)
            log.warning("states of axes not kept", reason=str(error))
            return
        self._kept_at = self._clock.monotonic()
        if mark is not None:
            self._source.commit(mark)

    def _packed(self) -> list[Checkpoint]:
        return [
            Checkpoint(axis.plan.name, name, axis.key, axis.t, state, lam=None, frozen=False)
            for number, axis in enumerate(self._axes)
            for name, state in (
                *axis.to_bytes().items(),
                *self._memories.packed(number, axis.memory),
            )
        ]
