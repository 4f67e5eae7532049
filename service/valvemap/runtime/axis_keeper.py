"""Saves the states of axes, and counts what was not saved."""

import asyncio
import math
from collections.abc import Sequence

import structlog

from valvemap.clock import Clock
from valvemap.errors import StateFileLost, StorageError
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.store_ports import Checkpoint, CheckpointStore

log = structlog.get_logger(__name__)


class AxisKeeper:
    """Implements `KeptElsewhere`: the alarm Checkpoint and the service's counters include it.

    Parameters
    ----------
    axes
        The axes.
    store
        Where their states are.
    clock
        Time of the saves.
    interval_s
        Between two saves.

    Attributes
    ----------
    failures : int
        Saves that failed.
    """

    def __init__(
        self, axes: Sequence[Axis], store: CheckpointStore, clock: Clock, interval_s: float
    ) -> None:
        self.failures = 0
        self._axes, self._store, self._clock = axes, store, clock
        self._interval_s = interval_s
        self._kept_at = clock.monotonic()
        self._due = self._kept_at + interval_s
        self._file_lost = False

    def age_s(self, now: float) -> float:
        """Time since the last save, s; before the first, since the start; ∞: the file was lost."""
        lost, self._file_lost = self._file_lost, False
        return math.inf if lost else now - self._kept_at

    def stored(self) -> list[tuple[str, str, bytes]]:
        """Return axis, name and bytes of each stored state."""
        return [(one.valve, one.estimator, one.state) for one in self._store.load()]

    async def keep_if_due(self) -> None:
        """Save the states once per interval."""
        now = self._clock.monotonic()
        if now >= self._due:
            self._due = now + self._interval_s
            await self.keep()

    async def keep(self) -> None:
        """Save the states; an error is counted and logged, and the next save tries again.

        They are packed here: a job's outcome must not change one halfway.
        """
        kept = [
            Checkpoint(axis.plan.name, name, axis.key, axis.t, state, lam=None, frozen=False)
            for axis in self._axes
            for name, state in axis.to_bytes().items()
        ]
        try:
            await asyncio.to_thread(self._store.save, kept)
        except StorageError as error:
            self.failures += 1
            self._file_lost = isinstance(error, StateFileLost)
            log.warning("states of axes not kept", reason=str(error))
            return
        self._kept_at = self._clock.monotonic()
