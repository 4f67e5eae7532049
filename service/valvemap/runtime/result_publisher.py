"""Publishes new results in turns; a valve whose results cannot be published stops alone."""

from collections.abc import Iterable, Sequence
from contextlib import suppress

import numpy as np
import structlog
from numpy.typing import NDArray

from valvemap.clock import Clock
from valvemap.errors import ValvemapError
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.result_ports import ResultSink
from valvemap.pipeline.results import Results
from valvemap.runtime.past import PastKeeper
from valvemap.runtime.publishing_turns import PublishingTurns
from valvemap.runtime.sample_ages import SampleAges

log = structlog.get_logger(__name__)


class ResultPublisher:
    """Holds the valves with new results and shows them to the sink.

    Attributes
    ----------
    lost, old : bool (M,)
        Valves whose sensors are lost, and whose newest sample is too old; set by the caller.

    Parameters
    ----------
    share
        Largest share of the time that is spent on publishing while results wait.
    budget_s
        Longest time of one turn, s.
    stale_after_s
        Age at which a sample is too old, s.
    """

    def __init__(
        self,
        identification: Identification,
        sink: ResultSink,
        past: PastKeeper | None,
        clock: Clock,
        ages: SampleAges,
        *,
        share: float,
        budget_s: float,
        stale_after_s: float,
    ) -> None:
        self.lost = np.zeros(len(identification.plans), np.bool_)
        self.old = np.zeros(len(identification.plans), np.bool_)
        self._identification = identification
        self._sink = sink
        self._past = past
        self._clock = clock
        self._ages = ages
        self._budget_s = budget_s
        self._stale_after_s = stale_after_s
        self._turns = PublishingTurns(share, stale_after_s)

    def __len__(self) -> int:
        """Return the number of valves that wait."""
        return len(self._turns)

    @property
    def late(self) -> bool:
        """Whether results are stale before they are replaced."""
        return self._turns.late

    def note_new(self, valves: Iterable[int]) -> None:
        """Publish these valves in one of the next turns."""
        self._turns.add(valves, self._clock.monotonic())

    async def publish_in_turn(self, *, samples_wait: bool) -> None:
        """Publish what the budget and the share of time allow."""
        began = self._clock.monotonic()
        if not self._turns.are_due(began):
            return
        await self.publish_until(began + self._budget_s)
        self._turns.pause(began, self._clock.monotonic(), samples_wait=samples_wait)

    async def publish_until(self, end: float) -> None:
        """Publish until this time (monotonic, s), or until no valve waits."""
        while len(self._turns):
            was_late = self._turns.late
            some = self._turns.next(self._clock.monotonic())
            late = self._turns.late
            if late and not was_late:
                log.warning("results are published late", remedy="fewer valves, or more CPU")
            old = self.old | late | self._soon_old()
            for results in self._identification.results.of(some, self.lost, old):
                try:
                    await self._show(results)
                except ValvemapError:
                    raise
                except Exception:  # noqa: BLE001 - a bulkhead: the failing valve is found next
                    await self._show_alone(results.valves.tolist(), old)
            if self._clock.monotonic() >= end:
                break

    async def _show(self, results: Results) -> None:
        await self._sink.publish(results)
        if self._past is not None:
            self._past.note(results)

    async def _show_alone(self, valves: Sequence[int], old: NDArray[np.bool_]) -> None:
        """Publish valve by valve; stop the lane of a valve that raises, and publish it as Bad."""
        for valve in valves:
            try:
                for results in self._identification.results.of([valve], self.lost, old):
                    await self._show(results)
            except Exception as error:  # noqa: BLE001 - a bulkhead: the others are published
                self._identification.stop(valve, Step.PUBLICATION, error)
                with suppress(Exception):  # the failure itself is logged
                    await self._sink.publish(self._identification.results.unknown(valve))

    def _soon_old(self) -> NDArray[np.bool_]:
        """Mask (M,) of valves whose newest sample will be too old before the next publication."""
        then = self._ages.of() + self._turns.round_s
        return (then > self._stale_after_s) & ~self._identification.stamping.holds
