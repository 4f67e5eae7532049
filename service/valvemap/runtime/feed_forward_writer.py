"""Writes the required U of standing demands to the valves armed for feed-forward."""

import asyncio
import math
from collections.abc import Awaitable, Callable, Sequence

import numpy as np
import structlog
from numpy.typing import NDArray

from valvemap.clock import Clock
from valvemap.errors import SourceRejected, ValvemapError
from valvemap.model.samples import Times
from valvemap.pipeline.feedforward import FeedForwardState, Refusals, Situation, decide, written
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.ports import AllSources
from valvemap.vocabulary.statuses import FeedForwardStatus

AGAIN_S = 0.05  # s; interval of steps without new samples: each batch of samples makes a step

log = structlog.get_logger(__name__)


class FeedForwardWriter:
    """Advances feed-forward of each configured valve by one step, and logs changes of its status.

    Parameters
    ----------
    identification
        Provides the required U and the armed valves.
    source
        The server that receives the writes.
    clock
        Time of the steps.
    situation
        Returns the connection, sample age and map status of a valve.
    note_new
        Called with the valves that have new results to publish.
    """

    def __init__(
        self,
        identification: Identification,
        source: AllSources,
        clock: Clock,
        situation: Callable[[int], Situation],
        note_new: Callable[[Sequence[int]], None],
    ) -> None:
        self._identification = identification
        self._source = source
        self._clock = clock
        self._situation = situation
        self._note_new = note_new
        self._written_at = np.full(len(identification.plans), clock.monotonic())
        self._states = {
            number: FeedForwardState()
            for number, plan in enumerate(identification.plans)
            if plan.feed_forward is not None
        }

    def are_due(self, valves: Times, now: float) -> NDArray[np.bool_]:
        """Return a mask of the valves whose last step is at least AGAIN_S old."""
        return now - self._written_at[valves] >= AGAIN_S

    async def write(self, valves: Times) -> None:
        """Advance each configured valve among ``valves`` by one step, concurrently."""
        self._written_at[valves] = self._clock.monotonic()
        chosen = set(valves.tolist()) & self._states.keys() if self._states else set()
        led = [valve for valve in self._states if valve in chosen]
        steps = (self._lead(valve) for valve in led)
        outcomes = await asyncio.gather(*steps, return_exceptions=True)
        for valve, outcome in zip(led, outcomes, strict=True):
            if isinstance(outcome, Exception) and not isinstance(outcome, ValvemapError):
                inverse = self._identification.plans[valve].inverse
                self._identification.stop(valve, Step.INVERSE, outcome, inverse)
            elif outcome is not None:
                raise outcome

    async def _lead(self, valve: int) -> None:
        settings = self._identification.plans[valve].feed_forward
        assert settings is not None  # noqa: S101 - these valves have a state
        before, situation = self._states[valve], self._situation(valve)
        state, command = decide(settings, before, situation, self._clock.monotonic())
        if state.status is not before.status:
            self._say(valve, state.status)
        self._states[valve] = state
        U_taken = command.U is None or await _is_taken(
            self._source.write_required_U(valve, command.U), state.refused_U
        )
        heartbeat_taken = command.heartbeat is None or await _is_taken(
            self._source.write_heartbeat(valve, command.heartbeat), state.refused_heartbeat
        )
        self._states[valve] = written(
            state,
            command,
            self._clock.monotonic(),
            U_refused=not U_taken,
            heartbeat_refused=not heartbeat_taken,
        )

    def _say(self, valve: int, status: FeedForwardStatus) -> None:
        self._identification.note_feed_forward(valve, status)
        self._note_new([valve])
        name = self._identification.plans[valve].name
        log.info("feed-forward", valve=name, status=status.name, why=status.sentence)


async def _is_taken(write: Awaitable[None], refused: Refusals) -> bool:
    try:
        await write
    except SourceRejected as error:
        if math.isinf(refused.last):
            log.warning("not written", reason=str(error))
        return False
    return True
