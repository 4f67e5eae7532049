"""Commissioning runs inside the running service, commanded over OPC UA."""

import asyncio
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Final

import structlog

from valvemap.app.commission import CommissionRun
from valvemap.app.commission_settings import settings_of
from valvemap.clock import Clock
from valvemap.config.loading import config_of
from valvemap.config.models import Config
from valvemap.errors import CommandRejected, ValvemapError
from valvemap.pipeline.commission_ports import CommissionResults, CommissionSink
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.operator_signs import OperatorSigns
from valvemap.storage.commission_files import RunFiles, last_run, new_run
from valvemap.vocabulary.commission import Phase

END_S: Final = 2.0  # s; longest wait for runs to return to their safe U at the service's end

log = structlog.get_logger(__name__)


@dataclass
class _Run:
    """One run under way, when it was started, s, and the signs of its operator."""

    run: CommissionRun
    task: asyncio.Task[None]
    began: float
    signs: OperatorSigns = field(default_factory=OperatorSigns)


class Commissions:
    """Fulfils `CommissionOperator`: at most one run for each valve.

    While a run leads a valve, its feed-forward cannot be armed.

    Parameters
    ----------
    config
        Of the service.
    identification
        Says whether feed-forward is armed.
    sink
        Shows the runs.
    """

    def __init__(
        self, config: Config, identification: Identification, sink: CommissionSink, clock: Clock
    ) -> None:
        self._config, self._identification = config, identification
        self._sink, self._clock = sink, clock
        self._folder = config.state.file.parent / "commission"
        self._runs: dict[str, _Run] = {}
        self.valves = [plan.name for plan in identification.plans if plan.is_driven]

    def start_commission(self, valve: str, accuracy: float, user: str) -> None:
        """Start a run; see `CommissionOperator`."""
        self._begin(valve, accuracy, user, new_run(self._folder, valve, self._clock.now()))

    def resume_commission(self, valve: str, accuracy: float, user: str) -> None:
        """Continue the last run; see `CommissionOperator`."""
        file = last_run(self._folder, valve)
        if file is None:
            raise CommandRejected(f"{valve}: there is no run to resume; Start begins one")
        most_s = config_of(self._config, valve).valves[0].commission.most_s
        if RunFiles(file, valve).elapsed() >= most_s:
            raise CommandRejected(f"{valve}: the last run was complete; Start begins a new one")
        self._begin(valve, accuracy, user, file)

    def _begin(self, valve: str, accuracy: float, user: str, file: Path) -> None:
        if valve in self._runs:
            raise CommandRejected(f"{valve}: a run is under way; Abort ends it")
        number = next(n for n, one in enumerate(self._config.valves) if one.name == valve)
        if self._identification.armed.is_armed(number):
            raise CommandRejected(f"{valve}: feed-forward is armed: disarm it first")
        config = config_of(self._config, valve)
        files = RunFiles(file, valve)
        run = CommissionRun(
            config,
            settings_of(config.valves[0], accuracy / 1.96),
            files,
            operator=partial(self._operator, valve),
            progress=lambda line: self._show(valve, line, file),
            clock=self._clock,
            user=user,
        )
        self._identification.lead(valve, by_another=True)
        task = asyncio.create_task(self._work(valve, run, files))
        self._runs[valve] = _Run(run, task, self._clock.monotonic())
        log.info("commissioning started", valve=valve, user=user, recording=str(file))

    def abort_commission(self, valve: str) -> None:
        """Abort a run."""
        if valve not in self._runs:
            raise CommandRejected(f"{valve}: no run is under way")
        self._runs[valve].run.abort()

    def note_operator(self, valve: str) -> None:
        """Note a sign of the operator."""
        if valve in self._runs:
            one = self._runs[valve]
            one.signs = one.signs.after(self._clock.monotonic())

    async def end(self) -> None:
        """Let all runs return to their safe U, and end."""
        for one in self._runs.values():
            one.run.abort()
        tasks = [one.task for one in self._runs.values()]
        if tasks:
            _, late = await asyncio.wait(tasks, timeout=END_S)
            for task in late:
                task.cancel()
            await asyncio.gather(*late, return_exceptions=True)

    async def _work(self, valve: str, run: CommissionRun, files: RunFiles) -> None:
        """Run to the end; an error of one run is that run's result."""
        try:
            with files:
                await run.run()
        except ValvemapError as error:
            log.warning("commissioning ended", valve=valve, reason=str(error))
            self._sink.show_commission(valve, _ended(str(error), files.recording))
        except Exception as error:
            log.exception("commissioning failed", valve=valve)
            why = f"{type(error).__name__}: {error}"
            self._sink.show_commission(valve, _ended(why, files.recording))
        else:
            self._show(valve, run.in_words(), files.recording)
            log.info("commissioning ended", valve=valve, phase=run.state.phase.label)
        finally:
            self._identification.lead(valve, by_another=False)
            del self._runs[valve]

    def _operator(self, valve: str) -> tuple[float, float]:
        """Age of the operator's last sign, and by how much the next one is late, s."""
        one, now = self._runs.get(valve), self._clock.monotonic()
        if one is None:
            return 0.0, 0.0
        one.signs = one.signs.at(now)
        return now - max([one.began, *one.signs.heard[-1:]]), one.signs.late_s(now)

    def _show(self, valve: str, line: str, file: Path) -> None:
        one = self._runs.get(valve)
        if one is None:
            return
        results = replace(one.run.results(), progress=line, recording=str(file))
        if results.phase.is_over:  # it writes no more, while it still learns its last samples
            self._identification.lead(valve, by_another=False)
        self._sink.show_commission(valve, results)


def _ended(why: str, file: Path) -> CommissionResults:
    line = f"{Phase.ABORTED.sentence}: {why}"
    return CommissionResults(Phase.ABORTED, why, line, time_left=0.0, recording=str(file))
