"""Writes the required U of standing demands to the valves that are armed for feed-forward."""

import asyncio
import math
from collections.abc import Awaitable, Mapping
from typing import Protocol

import numpy as np
import structlog
from numpy.typing import NDArray

from valvemap.clock import Clock
from valvemap.errors import SourceRejected, ValvemapError
from valvemap.model.samples import Times
from valvemap.pipeline.feedforward import (
    FeedForward,
    FeedForwardState,
    Refusals,
    Situation,
    decide,
    written,
)
from valvemap.pipeline.source_ports import AllSources
from valvemap.vocabulary.feed_forward import FeedForwardStatus

AGAIN_S = 0.05  # s; interval of steps without new samples: each batch of samples makes a step

log = structlog.get_logger(__name__)


class Led(Protocol):
    """The led valves, or axes. Numbers are those of the source's rows."""

    @property
    def settings(self) -> Mapping[int, FeedForward]:
        """Settings of what has a node to write to."""

    def name(self, number: int) -> str:
        """Name for the log."""

    def situation(self, number: int) -> Situation:
        """Return whether it is armed, its sample and its answer."""

    def note_status(self, number: int, status: FeedForwardStatus) -> None:
        """Publish a new status."""

    def fail(self, number: int, error: Exception) -> None:
        """Stop it alone after an unexpected error."""


class FeedForwardWriter:
    """Advances feed-forward of everything configured by one step, and logs changes of its status.

    Parameters
    ----------
    led
        The led valves, or axes.
    rows
        How many rows the source has.
    source
        The server that receives the writes.
    clock
        Time of the steps.
    """

    def __init__(self, led: Led, rows: int, source: AllSources, clock: Clock) -> None:
        self._led = led
        self._source = source
        self._clock = clock
        self._written_at = np.full(rows, clock.monotonic())
        self._settings = led.settings
        self._states = {number: FeedForwardState() for number in self._settings}

    def are_due(self, valves: Times, now: float) -> NDArray[np.bool_]:
        """Return a mask of the rows whose last step is at least AGAIN_S old."""
        return now - self._written_at[valves] >= AGAIN_S

    async def write(self, valves: Times) -> None:
        """Advance the configured ones among the rows ``valves`` by one step, concurrently."""
        self._written_at[valves] = self._clock.monotonic()
        if not self._states:
            return
        chosen = set(valves.tolist()) & self._states.keys()
        led = [valve for valve in self._states if valve in chosen]
        steps = (self._step(valve) for valve in led)
        outcomes = await asyncio.gather(*steps, return_exceptions=True)
        for valve, outcome in zip(led, outcomes, strict=True):
            if isinstance(outcome, Exception) and not isinstance(outcome, ValvemapError):
                self._led.fail(valve, outcome)
            elif outcome is not None:
                raise outcome

    async def _step(self, valve: int) -> None:
        settings = self._settings[valve]
        before, situation = self._states[valve], self._led.situation(valve)
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
        self._led.note_status(valve, status)
        name = self._led.name(valve)
        log.info("feed-forward", valve=name, status=status.name, why=status.sentence)


async def _is_taken(write: Awaitable[None], refused: Refusals) -> bool:
    try:
        await write
    except SourceRejected as error:
        if math.isinf(refused.last):
            log.warning("command not written to the valve", reason=str(error))
        return False
    return True
