"""Runs a commissioning: subscribes to the source, writes U, learns the map, keeps the files."""

import asyncio
import getpass
import math
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
import structlog

from guarded_opcua import CertificateError
from valvemap.app.build import build_alignment, build_timing
from valvemap.app.commission_settings import for_audit, quick
from valvemap.app.connections import build_source, build_supervisor_settings
from valvemap.app.page_access import Watched
from valvemap.app.page_access import settings_of as settings_for_client
from valvemap.clock import Clock, SystemClock
from valvemap.config.estimators import AutoConfig, build_estimator
from valvemap.config.models import Config
from valvemap.config.valves import ValveConfig
from valvemap.errors import (
    SourceError,
    SourceLost,
    ValvemapError,
)
from valvemap.model.estimator import Estimator
from valvemap.model.samples import Samples, Times
from valvemap.opcua_client.results_client import ResultsClient
from valvemap.opcua_client.source_settings import Security
from valvemap.opcua_results.namespaces import SERVICE_NAMESPACE
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.source_nodes import HEARTBEAT, LOAD, REQUIRED_U
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.commission import lost, start, step, written
from valvemap.pipeline.commission_learner import Learnt, learn
from valvemap.pipeline.commission_ports import CommissionResults
from valvemap.pipeline.commission_state import Command, CommissionState, Seen, Settings
from valvemap.pipeline.commission_words import in_words
from valvemap.pipeline.data_changes import DataChanges
from valvemap.runtime.clock_timeout import within
from valvemap.runtime.supervisor import supervise
from valvemap.storage.commission_files import RunFiles
from valvemap.vocabulary.commission import Phase
from valvemap.vocabulary.statuses import Quality

TICK_S: Final = 0.02  # s; interval of steps without new samples
LEARN_S: Final = 1.0  # s between two fits of the map
NOTE_S: Final = 1.0  # s between two lines of the audit record
ASK_S: Final = 2.0  # s; timeout of the question to the service
WRITE_S: Final = 0.3  # s of the run's clock; a write that takes longer is taken as lost
_ROLES: Final = {"U": REQUIRED_U, "load": LOAD, "heartbeat": HEARTBEAT}  # by field of Command

log = structlog.get_logger(__name__)


async def is_armed(config: Config, data: Path) -> bool:
    """Return whether the running service has armed feed-forward for the valve.

    A service that is not there, or does not answer us, has not: a second writer is also seen by
    the run's own checks.
    """
    security = Security(config.source.security)
    service = Watched(config.server.url, security, data / "pki" / "dashboard")
    client = ResultsClient(settings_for_client(service, ASK_S), SERVICE_NAMESPACE)
    try:
        await client.connect()
        (armed,) = await client.read([f"{config.valves[0].name}.Inverse.Armed"])
    except (ValvemapError, CertificateError) as error:
        log.info("the service was not asked whether feed-forward is armed", reason=str(error))
        return False
    finally:
        await client.close()
    return armed.value is True


def estimator_for(valve: ValveConfig) -> Estimator[Any]:
    """Return the estimator that a run learns with: `Auto`."""
    ranges = valve.U_range_percent, valve.dp_range_bar, valve.Q_range_l_min
    return build_estimator(AutoConfig(), *ranges)


class CommissionRun:
    """One run on one valve; fulfils :class:`valvemap.runtime.supervisor.Consumer`.

    Parameters
    ----------
    config
        With this valve alone.
    files
        Recording and audit record, open.
    operator
        Returns the age of the operator's last sign, and by how much the next one is late, s.
    progress
        Called with a line of words about every 0.2 s.
    armed
        Whether the service has armed feed-forward.
    user
        Who started it, for the audit record; None: the process's user.
    """

    def __init__(
        self,
        config: Config,
        settings: Settings,
        files: RunFiles,
        *,
        operator: Callable[[], tuple[float, float]] = lambda: (0.0, 0.0),
        progress: Callable[[str], None] = lambda _line: None,
        armed: bool = False,
        user: str | None = None,
        clock: Clock | None = None,
        source: OpcUaSource | None = None,
    ) -> None:
        (valve,) = config.valves
        self._config = quick(config)
        self._settings = settings
        self._files = files
        self._operator = operator
        self._progress = progress
        self._user = getpass.getuser() if user is None else user
        self._clock = clock or SystemClock()
        self._source = source or build_source(self._config)
        self._arrivals = Arrivals(
            [valve.name], build_alignment(self._config), build_timing(self._config)
        )
        self._estimator = estimator_for(valve)
        self._valve = valve.name
        self._stop = asyncio.Event()
        self._seen = Seen(connected=False, feed_forward=armed)
        self._arrived = -math.inf
        self._waiting: list[Samples] = []
        self._learning: asyncio.Task[Learnt] | None = None
        self._due = {"learn": 0.0, "note": 0.0, "progress": 0.0}
        self.state = CommissionState()
        self.learnt = Learnt(self._estimator.initial_state())

    def abort(self) -> None:
        """Return to the safe U, then end."""
        self._seen = replace(self._seen, abort=True)

    def in_words(self) -> str:
        """Return the progress as a line for the operator."""
        return in_words(self._settings, self.state, self._seen)

    def results(self) -> CommissionResults:
        """Return how the run stands."""
        left = max(self._settings.plan.most_s - self.state.elapsed, 0.0)
        return CommissionResults(
            self.state.phase,
            self.state.why,
            time_left=0.0 if self.state.phase.is_over else left,
            map_std=self.learnt.error,
        )

    async def run(self) -> CommissionState:
        """Run until the end; a lost source pauses the run.

        Raises
        ------
        SourceLost, SourceRejected
            if the first connection fails.
        StorageError, RecordingError
        """
        elapsed = self._files.elapsed()
        for samples in self._files.before():
            self.learnt = await asyncio.to_thread(self._learnt, samples)
        self.state = start(CommissionState(elapsed=elapsed), self._clock.monotonic())
        self._note(event="started", user=self._user, settings=for_audit(self._settings))
        settings = replace(build_supervisor_settings(self._config), tick_s=TICK_S)
        try:
            await supervise(self._source, self, self._clock, self._stop, settings)
        finally:
            if self._learning is not None:
                self.learnt = await self._learning
            if self._waiting:
                self.learnt = self._learnt(Samples.concatenate(self._waiting))
            self._note(event="ended", map_std_l_min=_known(self.learnt.error))
        return self.state

    async def connected(self, _valves: Times | None = None, *, restarted_at: int | None) -> None:
        """Note the connection; after a restart of the source, restart the sample sequence."""
        if restarted_at is not None:
            self._append(self._arrivals.begin_source_anew(np.arange(1), restarted_at).get(0))
        self._seen = replace(self._seen, connected=True)

    async def lost(self, reason: SourceError, _valves: Times | None = None) -> None:
        """Note the outage; the source's watchdog has taken the valve back, or will."""
        self._seen = replace(self._seen, connected=False)
        self._note(event="source lost", reason=str(reason))

    async def take(self, changes: DataChanges, _valves: Times | None = None) -> None:
        """Keep samples; the step follows in `tick`."""
        self._append(self._arrivals.take(changes).get(0))

    async def tick(self, _valves: Times | None = None) -> None:
        """Advance the run by one step."""
        now = self._clock.monotonic()
        self._learn(now)
        before = self.state
        age_s, late_s = self._operator()
        self._seen = replace(
            self._seen, age_s=now - self._arrived, operator_age_s=age_s, operator_late_s=late_s
        )
        self.state, command = step(self._settings, before, self._seen, now)
        self._seen = replace(self._seen, came=Samples.empty())
        await self._write(command)
        changed = (before.phase, before.reason) != (self.state.phase, self.state.reason)
        if changed or now >= self._due["note"]:
            self._due["note"] = now + NOTE_S
            self._note(event="phase" if changed else "at")
        if changed or now >= self._due["progress"]:
            self._due["progress"] = now + 0.2
            self._progress(self.in_words())
        if self.state.phase.is_over:
            self._stop.set()

    async def _write(self, command: Command) -> None:
        if command == Command():
            return
        given = {role: getattr(command, name) for name, role in _ROLES.items()}
        commands = {role: value for role, value in given.items() if value is not None}
        try:
            writing = self._source.write_commands(0, commands)
            refused = await within(WRITE_S, self._clock, writing)
        except (SourceLost, TimeoutError) as error:  # it may have been taken, or not
            self._note(event="write lost", reason=str(error) or "no response")
            self.state = lost(self.state, self._clock.monotonic())
            return
        for reason in refused.values():
            self._note(event="refused", reason=reason)
        taken = replace(command, **{name: None for name, of in _ROLES.items() if of in refused})
        now = self._clock.monotonic()
        self.state = written(self.state, taken, now, refused=bool(refused))

    def _append(self, samples: Samples | None) -> None:
        if samples is None or not len(samples):
            return
        self._files.append(samples)
        self._waiting.append(samples)
        self._arrived = self._clock.monotonic()
        last = samples[-1:]
        U, p1, p2, Q = (float(x[0]) for x in (last.U, last.p1, last.p2, last.Q))
        good = bool(last.quality[0] == Quality.GOOD)
        came = Samples.concatenate([self._seen.came, samples])
        self._seen = replace(self._seen, U=U, p1=p1, p2=p2, Q=Q, good=good, came=came)

    def _learn(self, now: float) -> None:
        """Start a fit in a thread when one is due; the kernels release the interpreter's lock."""
        if self._learning is not None and self._learning.done():
            self.learnt, self._learning = self._learning.result(), None
            self._seen = replace(
                self._seen,
                error=self.learnt.error,
                expected=self.learnt.expected,
                route=self.learnt.route,
                route_number=self.learnt.number,
            )
        if self._learning is None and self._waiting and now >= self._due["learn"]:
            self._due["learn"] = now + LEARN_S
            samples, self._waiting = Samples.concatenate(self._waiting), []
            self._learning = asyncio.create_task(asyncio.to_thread(self._learnt, samples))

    def _learnt(self, samples: Samples) -> Learnt:
        return learn(self._estimator, self._settings, self.learnt, samples, self.state.at)

    def _note(self, **what: Any) -> None:  # noqa: ANN401 - JSON
        state = self.state
        self._files.note(
            {
                "t": datetime.fromtimestamp(self._clock.now() / 1e9, UTC).isoformat(),
                "valve": self._valve,
                **what,
                "phase": state.phase.name,
                "reason": state.why,
                "U_percent": _known(state.at.U),
                "load_bar": _known(state.at.load),
                "elapsed_s": round(state.elapsed, 2),
            }
        )


def _known(x: float) -> float | None:
    return x if math.isfinite(x) else None


def result_in_words(run: CommissionRun, files: RunFiles, valve: str) -> list[str]:
    """Return the run's result, line by line."""
    learnt, state = run.learnt, run.state
    lines = [f"{valve}: {state.phase.sentence}: {state.why} ({state.elapsed:.0f} s)"]
    if math.isfinite(learnt.error):
        lines.append(
            f"map        ± {1.96 * learnt.error:.2g} l/min (95 %, mean over U), at Δp of "
            f"{learnt.drops[0]:.0f} … {learnt.drops[1]:.0f} bar, which were seen"
        )
    if state.phase is not Phase.REFUSED or state.elapsed:
        lines.append(f"recording  {files.recording}: `valvemap replay {files.recording}` learns it")
    lines.append(f"audit      {files.audit}")
    return lines
