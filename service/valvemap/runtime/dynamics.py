"""Fits the dynamics of live valves, one at a time, in a thread."""

import asyncio
from dataclasses import dataclass

import structlog

from valvemap.clock import Clock, thread_seconds
from valvemap.daemon_thread import in_daemon_thread
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.dynamics_reference import Outcome
from valvemap.pipeline.dynamics_results import NOTHING_YET, DynamicsResults
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.valve_dynamics import DynamicsInTurn, Job
from valvemap.vocabulary.dynamics import DynamicsStatus

log = structlog.get_logger(__name__)


class LiveDynamics:
    """Gathers samples, fits, and notes the results at the identification.

    An error of one valve's fit is that valve's result.

    Parameters
    ----------
    share, window_s
        Of one core, that fits may take, in processor time; above 0. s of samples for a fit.
    """

    def __init__(
        self, identification: Identification, clock: Clock, share: float, window_s: float
    ) -> None:
        valves = len(identification.plans)
        self._identification, self._clock = identification, clock
        self._turns = DynamicsInTurn(valves, share, window_s, clock.monotonic())
        self._fit: asyncio.Task[None] | None = None
        for valve in range(valves):
            self._identification.note_dynamics(valve, NOTHING_YET)

    def take(self, samples: ByValve) -> None:
        """Take samples of any valves."""
        for valve in self._turns.take(samples):
            status = DynamicsStatus.TOO_SLOW
            self._identification.note_dynamics(valve, DynamicsResults(status, status.sentence))

    def tick(self) -> None:
        """Begin the fit that is due; not while kernels are still compiled."""
        if self._identification.journal is not None:
            return
        due = self._turns.job(self._clock.monotonic())
        if due is not None:
            self._fit = asyncio.create_task(self._work(*due))

    async def end(self) -> None:
        """Leave the fit under way."""
        if self._fit is not None:
            self._fit.cancel()
            await asyncio.gather(self._fit, return_exceptions=True)

    async def _work(self, valve: int, t: int, job: Job) -> None:
        measured = _Measured(job)
        try:
            self._identification.judge_dynamics(valve, await in_daemon_thread(measured), t)
        except Exception as error:
            status = DynamicsStatus.FAILED
            why = f"{status.sentence} ({type(error).__name__}: {error})"
            self._identification.note_dynamics(valve, DynamicsResults(status, why, t))
            name = self._identification.plans[valve].name
            log.exception("dynamics failed", valve=name, why=str(error))
        self._turns.end(valve, measured.seconds, self._clock.monotonic())


@dataclass
class _Measured:
    """A fit that counts the processor time of its thread: a busy machine does not prolong it."""

    job: Job
    seconds: float = 0.0

    def __call__(self) -> Outcome:
        began = thread_seconds()
        try:
            return self.job()
        finally:
            self.seconds = thread_seconds() - began
