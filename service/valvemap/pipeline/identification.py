"""The state of all valves, and the operator's commands on it.

The live service and the replay of recordings both use this object; it reads no clock and does no
I/O.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from valvemap.errors import CommandRejected
from valvemap.model.inversion import Inversion
from valvemap.model.samples import Samples, Times, Trace
from valvemap.pipeline.alarm_states import AlarmRule
from valvemap.pipeline.alarms import SERVICE_RULES
from valvemap.pipeline.alignment import Alignment, ByValve
from valvemap.pipeline.all_alarms import AllAlarms
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.approved_maps import ApprovedMaps
from valvemap.pipeline.armed_valves import ArmedValves
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.baseline import Baseline, Difference
from valvemap.pipeline.call_journal import Call, CallJournal, changes_state
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.dynamics_results import DynamicsResults
from valvemap.pipeline.estimator_commands import EstimatorCommands
from valvemap.pipeline.kept_columns import KeptColumns
from valvemap.pipeline.kept_states import KeptStates
from valvemap.pipeline.lane_failures import LaneFailure, Step
from valvemap.pipeline.line_inverse import LineInverse
from valvemap.pipeline.maps_and_surveys import MapsAndSurveys
from valvemap.pipeline.plausibility import Finding
from valvemap.pipeline.ports import (
    AlarmReport,
    Checkpoint,
    Command,
    Results,
    ValveDescription,
    ValveResult,
)
from valvemap.pipeline.provenance import Reviewed
from valvemap.pipeline.recommendation import Recommendation
from valvemap.pipeline.result_tables import ResultTables, descriptions
from valvemap.pipeline.sample_intake import SampleIntake
from valvemap.pipeline.timing import Timing
from valvemap.pipeline.valve_columns import Columns
from valvemap.pipeline.valve_state import Lane, Required, ValvePlan, ValveState
from valvemap.vocabulary.commands import NAMED, Subject
from valvemap.vocabulary.service_alarms import ServiceAlarm
from valvemap.vocabulary.statuses import FeedForwardStatus, Status


class Identification:
    """All valves of one service; implements :class:`valvemap.pipeline.ports.Operator`.

    A facade: it builds the parts and forwards calls to them; some parts are public.

    Parameters
    ----------
    plans
        Estimators, gate and settings of each valve.
    alignment, timing
        How the signals are aligned, and how their stamping is detected (None: it is configured).
    service_alarms
        Rules of the service's alarms.
    waits
        Names of the estimators that do not run in a preview; None: it is none. A preview notes all
        calls that change its state. An object in which all estimators run repeats them, and takes
        over.

    Attributes
    ----------
    journal : CallJournal or None
        The noted calls; None if this is no preview.
    """

    def __init__(
        self,
        plans: Sequence[ValvePlan],
        alignment: Alignment,
        timing: Timing | None = None,
        service_alarms: Mapping[ServiceAlarm, AlarmRule] = SERVICE_RULES,
        waits: Collection[str] | None = None,
    ) -> None:
        self.journal = None if waits is None else CallJournal()
        self._arrivals = arrivals = Arrivals([plan.name for plan in plans], alignment, timing)
        self._valves = valves = AllValves(plans, arrivals.timing, waits or ())
        self._intake = intake = SampleIntake(valves, arrivals)
        self._maps = maps = MapsAndSurveys(valves, intake)
        self._commands = commands = EstimatorCommands(valves)
        self._approved = approved = ApprovedMaps(valves, self._commands)
        self._alarms = alarms = AllAlarms(valves, service_alarms)
        self._armed = armed = ArmedValves(valves)
        self._lines = lines = LineInverse(valves, intake)
        self._results = ResultTables(
            valves, arrivals, intake, maps, approved, armed, commands, lines
        )
        self._kept = KeptStates(valves, arrivals, approved, alarms, maps, intake.splitter)
        self._columns = KeptColumns(valves, intake, approved)
        self._executors = {
            Subject.ESTIMATOR: commands,
            Subject.DEMAND: commands,
            Subject.BASELINE: approved,
            Subject.INVERSE: armed,
            Subject.ALARM: alarms,
        }
        self.plans = valves.plans

    def repeat(self, calls: Sequence[Call]) -> None:
        """Repeat the calls of a preview. A rejected command is rejected again."""
        for name, args, kws in calls:
            with suppress(CommandRejected):
                getattr(self, name)(*args, **kws)

    def take_over(self, successor: "Identification") -> None:
        """Replace the whole state by that of an object with the same plans."""
        vars(self).update(vars(successor))
        self._results.show_all_alarms_again()

    @changes_state
    def do(self, command: Command) -> None:
        """Carry out an operator's command.

        Raises
        ------
        CommandRejected
            with the reason; nothing is changed.
        """
        executor = self._executors[NAMED[command.action].on]
        getattr(executor, command.action)(*command.arguments)

    @changes_state
    def stop(self, valve: int, step: Step, error: Exception, estimator: str | None = None) -> None:
        """Stop a lane, or (None) all lanes of a valve, after an error outside of this object."""
        self._valves.stop(valve, step, estimator, error)

    def new_failures(self) -> list[LaneFailure]:
        """Return the lanes that stopped since the last call."""
        return self._valves.failures.take_new()

    def unknown(self, valve: int) -> Results:
        """Return Bad results of one valve, for use when :meth:`results` raises."""
        return self._results.unknown(valve)

    @changes_state
    def take(self, changes: DataChanges) -> ByValve:
        """Align data changes and estimate; return the samples they completed, by valve."""
        return self._intake.take(changes)

    @changes_state
    def announce(self, changes: DataChanges, now_s: float) -> None:
        """Find steps of the source's clock in changes received at ``now_s`` (monotonic), s.

        Call it before `take` of these changes, whole or in parts; recordings need no call.
        """
        self._arrivals.announce(changes, now_s)

    @changes_state
    def learn(self, arrived: ByValve) -> ByValve:
        """Estimate from aligned samples; return them, with implausible samples marked BAD."""
        return self._intake.learn(arrived)

    @changes_state
    def take_samples(self, valve: int, samples: Samples) -> tuple[Samples, Mapping[str, Trace]]:
        """Estimate from one valve's samples; return them as gated, and each estimator's trace."""
        return self._intake.take_samples(valve, samples)

    def waits(self) -> NDArray[np.bool_]:
        """Mask of the valves with samples in the reorder buffer."""
        return self._arrivals.waits()

    def pending(self) -> Times:
        """Number of samples of each valve that wait for signals or for earlier samples."""
        return self._arrivals.pending()

    @changes_state
    def wait_no_longer(self, valves: Times) -> ByValve:
        """Flush the reorder buffer of these valves; return the samples as `take` does."""
        return self._intake.wait_no_longer(valves)

    @changes_state
    def begin_source_anew(self, valves: Times) -> ByValve:
        """Reset the alignment of these valves: the running numbers of their source restart."""
        return self._intake.begin_source_anew(valves)

    def waited_for(self, valve: int) -> tuple[str, ...]:
        """Return the signals that are missing for a valve's samples, and a remedy."""
        return self._results.waited_for(valve)

    @changes_state
    def note_source(self, valve: int, words: tuple[str, ...]) -> None:
        """Note what the source says of a valve's nodes; shown as `waited_for` and by its alarms."""
        self._results.note_source(valve, words)
        fleet, m = self._valves.at(valve)
        fleet.alarms.note_source(m, "; ".join(words))

    @changes_state
    def note_dynamics(self, valve: int, found: DynamicsResults) -> None:
        """Note the dynamics of one valve; its results show them from now on."""
        self._results.note_dynamics(valve, found)

    def timing(self, valve: int) -> tuple[str, ...]:
        """Describe how each of a valve's signals is stamped."""
        return self._arrivals.how_signals_come(valve, self.plans[valve].nodes)

    def newly_timed(self) -> list[int]:
        """Return the valves whose signals were newly found to have different timestamps."""
        return self._arrivals.timing.newly_found()

    def holds(self) -> NDArray[np.bool_]:
        """Mask of the valves with on-change signals: their silence is no loss."""
        return self._arrivals.timing.holds

    def implausible(self) -> NDArray[np.bool_]:
        """Mask of the valves whose samples are rejected as implausible.

        Impossible pressures are rejected until ten times as many samples have been right;
        inconsistent flow and pressures, until a restart.
        """
        return self._intake.implausible

    def findings(self, valve: int) -> list[Finding]:
        """Return the reasons why a valve's signals are implausible."""
        return self._intake.findings(valve)

    def one_of_each_kind(self) -> list[int]:
        """Return the first valve of each group with the same plan."""
        return self._valves.one_of_each_kind()

    def lane(self, valve: str, estimator: str) -> Lane:
        """Return one estimator of one valve."""
        return self._valves.lane(valve, estimator)

    def state(self, valve: int) -> ValveState:
        """Return the state of one valve."""
        return self._valves.state(valve)

    def refresh_maps(self, share: float = 1.0) -> None:
        """Compute the next due inverse tables and surveys; results contain the newest.

        ``share`` limits this call to a fraction of them, so that other work is not delayed.
        """
        self._maps.refresh(share)

    def refresh_all_maps(self) -> None:
        """Compute every inverse table and survey."""
        self._maps.refresh_all()

    def results(
        self,
        valves: Sequence[int],
        lost: NDArray[np.bool_] | None = None,
        old: NDArray[np.bool_] | None = None,
    ) -> Iterator[Results]:
        """Return the results of the given valves, see :meth:`ResultTables.results`."""
        return self._results.results(valves, lost, old)

    def result(self, valve: int) -> ValveResult:
        """Return the results of one valve."""
        return self._results.result(valve)

    def recommendation(self, valve: int) -> Recommendation:
        """Return which estimator of one valve is recommended, and why."""
        return self._results.recommendation(valve)

    def counters(self, valve: int) -> Mapping[str, int]:
        """Return the counts of one valve's aligned, lost and rejected samples since the start."""
        return self._results.counters(valve)

    def descriptions(self) -> tuple[ValveDescription, ...]:
        """Return the descriptions of all valves for a results server."""
        return descriptions(self.plans)

    def predict(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, Status]:
        """Q (l/min), its standard deviation and status at one point."""
        return self._commands.predict(valve, estimator, U, dp, T)

    def predict_measurement(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, float, Status]:
        """Q, the 95 % interval of a new measurement (l/min), and status."""
        return self._commands.predict_measurement(valve, estimator, U, dp, T)

    def invert(self, valve: str, Q: float, dp: float, T: float) -> Inversion:
        """U for a demanded flow at a pressure drop; of a line, signed."""
        number = self._valves.numbers[valve]
        if self._lines.is_line(number):
            return self._lines.invert(number, Q, dp, T).as_inversion()
        return self._commands.invert(valve, Q, dp, T)

    def required(self, valve: int) -> tuple[Required, Status]:
        """Return the answer to a valve's standing demand, and its estimator's status."""
        return self._commands.required(valve)

    def compare(self, valve: str, estimator: str) -> Difference:
        """Return the difference of an estimator's map from the baseline's."""
        return self._approved.compare(valve, estimator)

    def predict_approved(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, Status]:
        """Q (l/min), its standard deviation and status at one point of the approved map."""
        return self._approved.predict(valve, estimator, U, dp, T)

    def baseline(self, valve: int) -> Baseline | None:
        """Return the approved map, or None."""
        return self._approved.of(valve)

    def alarmed(self) -> list[str]:
        """Return the valves that have ever had an active alarm."""
        return self._alarms.alarmed()

    def alarms(self, valve: str | None) -> tuple[AlarmReport, ...]:
        """Return the state of all alarms of a valve or (None) of the service."""
        return self._alarms.reports(valve)

    @changes_state
    def was_away(self) -> None:
        """Note an outage of the service: silence until now is no loss of the sensors."""
        self._alarms.was_away()

    @changes_state
    def say_overdue(self, valves: Times, now: Times) -> list[int]:
        """Note that these valves are silent until ``now``; return those with a new alarm."""
        return self._alarms.say_overdue(valves, now)

    @changes_state
    def watch_service(
        self,
        now: int,
        checkpoint_age_s: float,
        days_left: float,
        load: float,
        history_waits_s: float = math.nan,
    ) -> tuple[AlarmReport, ...]:
        """Update the service's alarms: age of the checkpoints, certificate, load, history."""
        return self._alarms.watch_service(now, checkpoint_age_s, days_left, load, history_waits_s)

    @changes_state
    def lead(self, valve: str, *, by_another: bool) -> None:
        """Note whether something else writes to the valve; if so, it cannot be armed."""
        self._armed.lead(valve, by_another=by_another)

    def is_armed(self, valve: int) -> bool:
        """Whether an operator has armed the valve's feed-forward since the start."""
        return self._armed.is_armed(valve)

    def feed_forward(self, valve: int) -> FeedForwardStatus:
        """Return the feed-forward status of the last step."""
        return self._armed.feed_forward(valve)

    @changes_state
    def note_feed_forward(self, valve: int, status: FeedForwardStatus) -> None:
        """Set the feed-forward status to publish."""
        self._armed.note(valve, status)

    def kept(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """Return `checkpoints` and `memories` of the given valves, or of all."""
        return self._kept.kept(valves)

    def checkpoints(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """Return every estimator's state as bytes, of the given valves or of all."""
        return self._kept.checkpoints(valves)

    def memories(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """Return the state beside the estimators as bytes, of the given valves or of all."""
        return self._kept.memories(valves)

    def review(self, stored: Sequence[Checkpoint]) -> Reviewed:
        """Compare stored checkpoints with the configuration, see :func:`provenance.review`."""
        return self._kept.review(stored)

    @changes_state
    def restore(self, checkpoints: Sequence[Checkpoint]) -> tuple[list[str], dict[str, str]]:
        """Restore the checkpoints that fit, see :meth:`KeptStates.restore`."""
        return self._kept.restore(checkpoints)

    def columns(self) -> list[Columns]:
        """Return the state of all valves as columns, without baselines."""
        return self._columns.columns()

    @changes_state
    def remember(
        self, columns: Sequence[Columns], baselines: Mapping[str, bytes]
    ) -> set[tuple[str, str]]:
        """Restore columns and baselines; return (key, valve) of the states that were reset."""
        return self._columns.remember(columns, baselines)

    def baselines(self) -> dict[str, bytes]:
        """Return the approved maps, packed, by valve."""
        return self._columns.baselines()
