"""States on disk, in turns: each valve's once in an interval, and how far the source was heard."""

import asyncio
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import structlog

from valvemap.clock import Clock
from valvemap.errors import StorageError
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.ports import AllSources, Checkpoint, CheckpointStore

POSITION = "Service", "Position"  # under this name, which no valve has, the source's is kept
KEPT_PER_S = 20  # valves whose states are kept in a second, 3 MB, unless more are due
KEPT_AT_ONCE = 64  # valves at most, 10 MB: an end waits for no more
PACKED_AT_ONCE = 16  # valves, at 1 ms each, before samples that have come are taken in

log = structlog.get_logger(__name__)


class StateKeeper:
    """Packs states a few valves at a time, and waits for no disk while the service lives.

    Parameters
    ----------
    identification
        Whose states.
    source
        Is asked for its position, and hears what is kept of what it sent.
    store
        Where to.
    clock
        Of the turns.
    interval_s
        Each state is kept once in that time at least; of few valves every second.

    Attributes
    ----------
    mark
        How far the source was heard, of what has been learnt.
    kept_at : float
        When something was kept last, monotonic s; NaN before.
    failures : int
        How often something was not.
    """

    def __init__(
        self,
        identification: Identification,
        source: AllSources,
        store: CheckpointStore,
        clock: Clock,
        interval_s: float,
    ) -> None:
        self.mark: Any = None
        self.kept_at = math.nan
        self.failures = 0
        self._identification = identification
        self._source = source
        self._store = store
        self._clock = clock
        self._valves = len(identification.plans)
        self._interval_s = min(interval_s, max(1.0, self._valves / KEPT_PER_S))
        self._began, self._turns = clock.monotonic(), 0  # turns that are over, saved or refused
        self._next = (
            0  # the valve saved longest ago: valves are saved in the order of their numbers
        )
        self._left_in_round = 0  # valves that are not saved since this round began
        self._mark_of_round: Any = None  # as this round began
        self._keeping: asyncio.Task[None] | None = None
        self._packing_s = self._saving_s = 0.0  # what it took last: a valve's state, a save

    def age_s(self, now: float) -> float:
        """How old what is kept is, s; before anything is, how long that has been due."""
        return now - (self._began if math.isnan(self.kept_at) else self.kept_at)

    def states(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """All that is known of some valves, or of all."""
        return self._identification.kept(valves)

    async def settle(self) -> None:
        """Wait for what is being kept."""
        if self._keeping is not None:
            await self._keeping

    async def keep(self, until: float = math.inf) -> bool:
        """Keep all states now, or those kept longest ago, as far as the disk does it by then.

        False: not all are. What was kept before is older, and the source is asked again for what
        came since.

        Raises
        ------
        StorageError
            naming the file; the states go on in memory.
        """
        M = self._valves
        await self.settle()
        oldest_first = np.roll(np.arange(M), -self._next).tolist()
        at_once = M if math.isinf(until) else KEPT_AT_ONCE
        for start in range(0, M, at_once):
            some = oldest_first[start : start + at_once]
            if self._clock.monotonic() + len(some) * self._packing_s + self._saving_s > until:
                return False
            states = await self._packed(some)
            if start + at_once >= M:
                states += self._position(self.mark)
            began = self._clock.monotonic()
            await asyncio.to_thread(self._store.save, states)
            self._saving_s = self._clock.monotonic() - began
        return True

    def keep_in_turn(self, now: float) -> None:
        """Begin to keep what is due, a few valves at a time: no batch waits for all.

        A round saves every valve once, and then the mark of its beginning. A valve leaves the
        round when it is saved: a refused save is repeated, so the mark is never ahead of a state.
        """
        if self._keeping is not None and not self._keeping.done():
            return
        M = self._valves
        due = int(M * (now - self._began) / self._interval_s)
        count = min(due - self._turns, M, KEPT_AT_ONCE)
        if count <= 0:
            return
        self._turns = due if M <= KEPT_AT_ONCE else self._turns + count
        if not self._left_in_round:
            self._left_in_round, self._mark_of_round = M, self.mark
        mark = self._mark_of_round if count >= self._left_in_round else None
        some = ((self._next + np.arange(count)) % M).tolist()
        self._keeping = asyncio.create_task(self._keep(some, mark))

    async def _keep(self, valves: Sequence[int], mark: Any) -> None:  # noqa: ANN401
        """The disk may be slow, or full: nothing waits for it."""
        try:
            states = [*await self._packed(valves), *self._position(mark)]
            began = self._clock.monotonic()
            await asyncio.to_thread(self._store.save, states)
        except StorageError as error:
            self.failures += 1
            log.warning("checkpoint not kept", reason=str(error))
            return
        self.kept_at = self._clock.monotonic()
        self._saving_s = self.kept_at - began
        self._next = (self._next + len(valves)) % self._valves
        self._left_in_round = max(self._left_in_round - len(valves), 0)
        if mark is not None:
            self._source.commit(mark)

    async def _packed(self, valves: Sequence[int]) -> list[Checkpoint]:
        """States as bytes, a few valves at a time: samples come in between."""
        packed = []
        for start in range(0, len(valves), PACKED_AT_ONCE):
            began = self._clock.monotonic()
            some = valves[start : start + PACKED_AT_ONCE]
            packed += self._states_of(some)
            self._packing_s = (self._clock.monotonic() - began) / len(some)
            await asyncio.sleep(0)
        return packed

    def _states_of(self, valves: Sequence[int]) -> list[Checkpoint]:
        """The same of valves at once, or one by one: a valve whose state cannot be packed stops."""
        try:
            return self.states(valves)
        except Exception as error:  # noqa: BLE001 - a bulkhead: the others are kept
            if len(valves) == 1:
                self._identification.stop(valves[0], Step.CHECKPOINT, error)
                return []
        return [one for valve in valves for one in self._states_of([valve])]

    def _position(self, mark: Any) -> list[Checkpoint]:  # noqa: ANN401
        if mark is None:
            return []
        state = self._source.position(mark)
        return [Checkpoint(*POSITION, "", self._clock.now(), state, lam=None, frozen=False)]
