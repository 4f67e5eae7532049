"""The service's model of the world: every valve's state, and what people may do to it.

Both the live service and the replay of recordings go through this one object; it knows neither
time nor network.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from valvemap.model.inversion import Inversion
from valvemap.model.samples import Samples, Times, Trace
from valvemap.pipeline.alarm_states import AlarmRule
from valvemap.pipeline.alarms import SERVICE_RULES, ServiceAlarm
from valvemap.pipeline.alignment import Alignment, ByValve
from valvemap.pipeline.all_alarms import AllAlarms
from valvemap.pipeline.all_valves import AllValves
from valvemap.pipeline.approved_maps import ApprovedMaps
from valvemap.pipeline.armed_valves import ArmedValves
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.baseline import Baseline, Difference
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.estimator_commands import EstimatorCommands
from valvemap.pipeline.kept_columns import KeptColumns
from valvemap.pipeline.kept_states import KeptStates
from valvemap.pipeline.lane_failures import LaneFailure, Step
from valvemap.pipeline.maps_and_surveys import MapsAndSurveys
from valvemap.pipeline.plausibility import Finding
from valvemap.pipeline.ports import (
    AlarmReport,
    Checkpoint,
    Remark,
    Results,
    ValveDescription,
    ValveResult,
)
from valvemap.pipeline.result_tables import ResultTables, descriptions
from valvemap.pipeline.sample_intake import SampleIntake
from valvemap.pipeline.timing import Timing
from valvemap.pipeline.valve_columns import Columns
from valvemap.pipeline.valve_state import Lane, Required, ValvePlan, ValveState
from valvemap.vocabulary.statuses import FeedForwardStatus, Status


class Identification:
    """All valves of one service; fulfils :class:`valvemap.pipeline.ports.Operator`.

    It puts the parts together and hands everything on to the one whose it is.

    Parameters
    ----------
    plans
        What is done with the samples of each valve.
    alignment, timing
        How their signals find together, and how it is found in what way they come (None: it is
        configured).
    service_alarms
        When each alarm of the service comes and goes.
    """

    def __init__(
        self,
        plans: Sequence[ValvePlan],
        alignment: Alignment,
        timing: Timing | None = None,
        service_alarms: Mapping[ServiceAlarm, AlarmRule] = SERVICE_RULES,
    ) -> None:
        self._arrivals = arrivals = Arrivals([plan.name for plan in plans], alignment, timing)
        self._valves = valves = AllValves(plans, arrivals.timing)
        self._intake = intake = SampleIntake(valves, arrivals)
        self._maps = maps = MapsAndSurveys(valves, intake)
        self._commands = commands = EstimatorCommands(valves)
        self._approved = approved = ApprovedMaps(valves, self._commands)
        self._alarms = alarms = AllAlarms(valves, service_alarms)
        self._armed = armed = ArmedValves(valves)
        self._results = ResultTables(valves, arrivals, intake, maps, approved, armed, commands)
        self._kept = KeptStates(valves, arrivals, approved, alarms, maps)
        self._columns = KeptColumns(valves, intake, approved)
        self.plans = valves.plans

    def stop(self, valve: int, step: Step, error: Exception, estimator: str | None = None) -> None:
        """Stop a lane, or (None) all lanes of a valve: a step outside of this object raised."""
        self._valves.stop(valve, step, estimator, error)

    def new_failures(self) -> list[LaneFailure]:
        """Lanes that stopped since the last call."""
        return self._valves.failures.take_new()

    def unknown(self, valve: int) -> Results:
        """Bad results of one valve, where the step that makes them raises."""
        return self._results.unknown(valve)

    def take(self, changes: DataChanges) -> ByValve:
        """Take data changes in; return the samples they completed, by valve."""
        return self._intake.take(changes)

    def learn(self, arrived: ByValve) -> ByValve:
        """Take aligned samples in; return them, those that cannot be what they are called BAD."""
        return self._intake.learn(arrived)

    def take_samples(self, valve: int, samples: Samples) -> tuple[Samples, Mapping[str, Trace]]:
        """Take samples of one valve in; return them as judged, and what every estimator said."""
        return self._intake.take_samples(valve, samples)

    def waits(self) -> NDArray[np.bool_]:
        """Which valves have samples that wait for earlier ones."""
        return self._arrivals.waits()

    def pending(self) -> Times:
        """How many samples of each valve wait for signals or for earlier samples."""
        return self._arrivals.pending()

    def wait_no_longer(self, valves: Times) -> ByValve:
        """Take what waits for earlier samples without them; return it as `take` does."""
        return self._intake.wait_no_longer(valves)

    def begin_source_anew(self, valves: Times) -> ByValve:
        """The source of some valves was restarted: its running numbers begin anew."""
        return self._intake.begin_source_anew(valves)

    def waited_for(self, valve: int) -> tuple[str, ...]:
        """Which signals keep a valve's samples from being made, and what would help."""
        return self._arrivals.waited_for(valve, self.plans[valve].nodes)

    def timing(self, valve: int) -> tuple[str, ...]:
        """How each of a valve's signals comes, in words."""
        return self._arrivals.how_signals_come(valve, self.plans[valve].nodes)

    def newly_timed(self) -> list[int]:
        """Valves of which it was found since the last call that their signals come in scans."""
        return self._arrivals.timing.newly_found()

    def holds(self) -> NDArray[np.bool_]:
        """Which valves have signals that come on change: silence is no loss of theirs."""
        return self._arrivals.timing.holds

    def implausible(self) -> NDArray[np.bool_]:
        """Which valves are not learnt from, because their signals cannot be what they are called.

        Pressures that cannot be are refused until they have been right for ten times as many
        samples; where flow and pressures contradict each other, until a restart.
        """
        return self._intake.implausible

    def findings(self, valve: int) -> list[Finding]:
        """What speaks against a valve's signals being what they are called."""
        return self._intake.findings(valve)

    def one_of_each_kind(self) -> list[int]:
        """Return the first of the valves that are treated alike, for every kind there is."""
        return self._valves.one_of_each_kind()

    def lane(self, valve: str, estimator: str) -> Lane:
        """One estimator as it stands."""
        return self._valves.lane(valve, estimator)

    def state(self, valve: int) -> ValveState:
        """One valve as it stands."""
        return self._valves.state(valve)

    def refresh_maps(self, share: float = 1.0) -> None:
        """Compute the next inverse tables and surveys anew; results show the newest of them.

        Or a ``share`` of those, for one whom others wait for.
        """
        self._maps.refresh(share)

    def refresh_all_maps(self) -> None:
        """Compute every inverse table and survey anew."""
        self._maps.refresh_all()

    def results(
        self,
        valves: Sequence[int],
        lost: NDArray[np.bool_] | None = None,
        old: NDArray[np.bool_] | None = None,
    ) -> Iterator[Results]:
        """What is published of some valves, see :meth:`ResultTables.results`."""
        return self._results.results(valves, lost, old)

    def result(self, valve: int) -> ValveResult:
        """The same of one valve."""
        return self._results.result(valve)

    def counters(self, valve: int) -> Mapping[str, int]:
        """What was aligned, lost and rejected of one valve since the start."""
        return self._results.counters(valve)

    def descriptions(self) -> tuple[ValveDescription, ...]:
        """What a results server must know."""
        return descriptions(self.plans)

    def reset(self, valve: str, estimator: str) -> None:
        """Forget all samples; what the operator set stays set."""
        self._commands.reset(valve, estimator)

    def freeze(self, valve: str, estimator: str) -> None:
        """Stop adaptation."""
        self._commands.freeze(valve, estimator)

    def resume(self, valve: str, estimator: str) -> None:
        """Adapt again."""
        self._commands.resume(valve, estimator)

    def set_forgetting_factor(self, valve: str, estimator: str, lam: float) -> None:
        """Use another forgetting factor from the next sample on."""
        self._commands.set_forgetting_factor(valve, estimator, lam)

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
        """U for a demanded flow at a pressure drop."""
        return self._commands.invert(valve, Q, dp, T)

    def demand(self, valve: str, Q: float, dp: float) -> None:
        """Set the standing demand; NaN takes it back."""
        self._commands.demand(valve, Q, dp)

    def required(self, valve: int) -> tuple[Required, Status]:
        """The answer to a valve's standing demand, and how its estimator stands."""
        return self._commands.required(valve)

    def approve(self, valve: str) -> None:
        """Keep what the estimators know as the valve's map when new."""
        self._approved.approve(valve)

    def roll_back(self, valve: str) -> None:
        """Have every estimator know what it knew when the baseline was approved."""
        self._approved.roll_back(valve)

    def replace_valve(self, valve: str) -> None:
        """Another valve is there: nothing that was learnt holds, there is no baseline any more."""
        self._approved.replace_valve(valve)

    def compare(self, valve: str, estimator: str) -> Difference:
        """By how much an estimator's map has moved away from the baseline's."""
        return self._approved.compare(valve, estimator)

    def baseline(self, valve: int) -> Baseline | None:
        """The map that was approved as new, if one was."""
        return self._approved.of(valve)

    def acknowledge(self, valve: str | None, alarm: str, remark: Remark) -> None:
        """Note that somebody has seen an alarm, of a valve or (None) of the service."""
        self._alarms.acknowledge(valve, alarm, remark)

    def confirm(self, valve: str | None, alarm: str, remark: Remark) -> None:
        """Note that an alarm that was acknowledged was dealt with."""
        self._alarms.confirm(valve, alarm, remark)

    def remark(self, valve: str | None, alarm: str, remark: Remark) -> None:
        """Note what somebody said of an alarm."""
        self._alarms.remark(valve, alarm, remark)

    def alarmed(self) -> list[str]:
        """The valves of which any alarm ever came."""
        return self._alarms.alarmed()

    def alarms(self, valve: str | None) -> tuple[AlarmReport, ...]:
        """How all alarms of a valve, or (None) of the service, stand."""
        return self._alarms.reports(valve)

    def was_away(self) -> None:
        """Nobody has listened to the source: silence until now is no loss of the sensors."""
        self._alarms.was_away()

    def say_overdue(self, valves: Times, now: Times) -> list[int]:
        """Some valves have sent nothing until ``now``; return those newly alarmed for that."""
        return self._alarms.say_overdue(valves, now)

    def watch_service(
        self, now: int, checkpoint_age_s: float, days_left: float, load: float
    ) -> tuple[AlarmReport, ...]:
        """Judge how the service itself stands: age of what is kept, certificate, share of time."""
        return self._alarms.watch_service(now, checkpoint_age_s, days_left, load)

    def arm(self, valve: str) -> None:
        """Have the answer to the standing demand written to the valve, while it may be."""
        self._armed.arm(valve)

    def disarm(self, valve: str) -> None:
        """Write nothing to the valve any more."""
        self._armed.disarm(valve)

    def is_armed(self, valve: int) -> bool:
        """Whether somebody has armed the valve's feed-forward since the start."""
        return self._armed.is_armed(valve)

    def feed_forward(self, valve: int) -> FeedForwardStatus:
        """Whether the answer was written to the valve when last looked at."""
        return self._armed.feed_forward(valve)

    def note_feed_forward(self, valve: int, status: FeedForwardStatus) -> None:
        """Publish from now on that a valve's feed-forward stands so."""
        self._armed.note(valve, status)

    def kept(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """All that is kept of some valves, or of all: `checkpoints` and `memories`."""
        return self._kept.kept(valves)

    def checkpoints(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """Every estimator's state as bytes, of some valves or of all."""
        return self._kept.checkpoints(valves)

    def memories(self, valves: Iterable[int] | None = None) -> list[Checkpoint]:
        """All that some valves, or all, remember beside their estimators' states."""
        return self._kept.memories(valves)

    def restore(self, checkpoints: Sequence[Checkpoint]) -> tuple[list[str], dict[str, str]]:
        """Take up what was kept, where it fits, see :meth:`KeptStates.restore`."""
        return self._kept.restore(checkpoints)

    def columns(self) -> list[Columns]:
        """All that the valves remember of their samples; no baselines."""
        return self._columns.columns()

    def remember(
        self, columns: Sequence[Columns], baselines: Mapping[str, bytes]
    ) -> set[tuple[str, str]]:
        """Take up columns and baselines; return (key, valve) of what starts afresh."""
        return self._columns.remember(columns, baselines)

    def baselines(self) -> dict[str, bytes]:
        """The approved maps, packed, by valve."""
        return self._columns.baselines()
