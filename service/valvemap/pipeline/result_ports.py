"""Ports to receivers of results, and the health of the service that they show."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from valvemap.model.samples import Floats, Times
from valvemap.pipeline.alarm_results import AlarmReport
from valvemap.pipeline.results import Results
from valvemap.pipeline.source_ports import SourceCounters


@dataclass(frozen=True)
class PastCounters:
    """Rows of the history that were lost, failed saves, and bytes of its file."""

    lost: int = 0
    failures: int = 0
    bytes: int = 0


@dataclass(frozen=True)
class StartState:
    """How far the service's start is: a sentence, and the compiled share of its kernels, %."""

    text: str
    compiled_percent: float


COMPLETE = StartState("complete: all estimators run", 100.0)


@dataclass(frozen=True)
class Health:
    """Freshness of the data and state of the checkpoints; arrays over all valves.

    Attributes
    ----------
    age_s : float64
        Age of the newest sample by the source's clock, s; NaN before the first.
    waiting : int64
        Samples that wait for signals or for earlier samples.
    source, source_states
        Counters summed over all sources; one line for each source.
    checkpoint_age_s : float
        Time since the last save of states, s; NaN before the first.
    checkpoint_failures, checkpoint_bytes, checkpoints_refused : int
        Saves that failed, size of the store, and checkpoints rejected at the start.
    alarms
        State of the service's alarms.
    history
        Counters of the history.
    start
        Progress of the service's start.
    """

    age_s: Floats
    waiting: Times
    source: SourceCounters = field(default_factory=SourceCounters)
    source_states: tuple[str, ...] = ()
    checkpoint_age_s: float = np.nan
    checkpoint_failures: int = 0
    checkpoint_bytes: int = 0
    checkpoints_refused: int = 0
    alarms: Sequence[AlarmReport] = ()
    history: PastCounters = PastCounters()
    start: StartState = COMPLETE


class ResultSink(Protocol):
    """Receiver of results; ``publish`` never waits for a reader."""

    async def publish(self, results: Results) -> None:
        """Publish results; a later call for the same valve replaces the earlier one."""

    async def doubt(self, valves: Times) -> None:
        """Set the published results of these valves to Uncertain or worse: they are old."""

    async def show_health(self, health: Health) -> None:
        """Publish the service's health."""
