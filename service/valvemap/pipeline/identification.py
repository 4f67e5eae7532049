"""The state of all valves, and the operator's commands on it.

The live service and the replay of recordings both use this object; it reads no clock and does no
I/O.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress

from valvemap.errors import CommandRejected
from valvemap.model.inversion import Inversion
from valvemap.model.samples import Samples, Times, Trace
from valvemap.pipeline.alarm_results import AlarmReport
from valvemap.pipeline.alarm_states import AlarmRule
from valvemap.pipeline.alignment import Alignment
from valvemap.pipeline.baseline import Baseline, Difference
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.call_journal import Call, CallJournal, changes_state, noted_call
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.dynamics_reference import Outcome
from valvemap.pipeline.dynamics_results import DynamicsResults
from valvemap.pipeline.identification_parts import Parts
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.operator_ports import Command
from valvemap.pipeline.readable_parts import (
    ReadableAnswers,
    ReadableArming,
    ReadableArrivals,
    ReadableColumns,
    ReadableFailures,
    ReadableMaps,
    ReadablePlausibility,
    ReadableResults,
    ReadableStates,
    ReadableTiming,
    ReadableValves,
)
from valvemap.pipeline.results import ValveDescription
from valvemap.pipeline.service_alarms import SERVICE_RULES
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.pipeline.timing import Timing
from valvemap.pipeline.valve_columns import Columns
from valvemap.pipeline.valve_descriptions import descriptions
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.vocabulary.commands import NAMED
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.service_alarms import ServiceAlarm
from valvemap.vocabulary.statuses import Status


class Identification:
    """All valves of one service; implements :class:`valvemap.pipeline.operator_ports.Operator`.

    The parts that are public are for reading, and replaced by `take_over`: look them up for each
    call. Calls that change the state are methods here, so that a preview can note them.

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
    results, maps, answers, armed
        Published: results, the tables in them, answers to standing demands, feed-forward.
    valves, failures
        The valves' own states, and the lanes that stopped.
    arrivals, stamping, plausibility
        Samples that wait, how they are stamped, why they are rejected.
    states, kept_columns
        The whole state as bytes, or as columns.
    """

    results: ReadableResults
    maps: ReadableMaps
    answers: ReadableAnswers
    armed: ReadableArming
    valves: ReadableValves
    failures: ReadableFailures
    arrivals: ReadableArrivals
    stamping: ReadableTiming
    plausibility: ReadablePlausibility
    states: ReadableStates
    kept_columns: ReadableColumns

    def __init__(
        self,
        plans: Sequence[ValvePlan],
        alignment: Alignment,
        timing: Timing | None = None,
        service_alarms: Mapping[ServiceAlarm, AlarmRule] = SERVICE_RULES,
        waits: Collection[str] | None = None,
    ) -> None:
        self.journal = None if waits is None else CallJournal()
        self.changes = 0
        self._parts = parts = Parts.of(plans, alignment, timing, service_alarms, waits or ())
        self.plans = parts.valves.plans
        self.results, self.maps = parts.results, parts.maps
        self.answers, self.armed = parts.commands, parts.armed
        self.valves, self.failures = parts.valves, parts.valves.failures
        self.arrivals, self.stamping = parts.arrivals, parts.arrivals.timing
        self.plausibility = parts.intake
        self.states, self.kept_columns = parts.kept, parts.columns

    @property
    def version(self) -> tuple[int, ...]:
        """Equal as long as no state that `states` packs has changed, but for alarms that last."""
        of_fleets = sum(fleet.changes for fleet in self._parts.valves.fleets)
        return self.changes, of_fleets, self._parts.alarms.of_service.version

    def repeat(self, calls: Sequence[Call]) -> None:
        """Repeat the calls of a preview. A rejected command is rejected again."""
        for name, args, kws in calls:
            with suppress(CommandRejected):
                getattr(self, name)(*args, **kws)

    def take_over(self, successor: "Identification") -> None:
        """Replace the whole state by that of an object with the same plans."""
        changes = self.changes + successor.changes
        vars(self).update(vars(successor))
        self.changes = changes + 1  # no version of before comes again
        self._parts.results.show_all_alarms_again()

    @changes_state
    def do(self, command: Command) -> None:
        """Carry out an operator's command.

        Raises
        ------
        CommandRejected
            with the reason; nothing is changed.
        """
        executor = self._parts.executor_of(NAMED[command.action].on)
        getattr(executor, command.action)(*command.arguments)

    @changes_state
    def stop(self, valve: int, step: Step, error: Exception, estimator: str | None = None) -> None:
        """Stop a lane, or (None) all lanes of a valve, after an error outside of this object."""
        self._parts.valves.stop(valve, step, estimator, error)

    @changes_state
    def take(self, changes: DataChanges) -> ByValve:
        """Align data changes and estimate; return the samples they completed, by valve."""
        return self._parts.intake.take(changes)

    @changes_state
    def announce(self, changes: DataChanges, now_s: float) -> None:
        """Find steps of the source's clock in changes received at ``now_s`` (monotonic), s.

        Call it before `take` of these changes, whole or in parts; recordings need no call.
        """
        self._parts.arrivals.announce(changes, now_s)

    @changes_state
    def learn(self, arrived: ByValve) -> ByValve:
        """Estimate from aligned samples; return them, with implausible samples marked BAD."""
        return self._parts.intake.learn(arrived)

    @changes_state
    def take_samples(self, valve: int, samples: Samples) -> tuple[Samples, Mapping[str, Trace]]:
        """Estimate from one valve's samples; return them as gated, and each estimator's trace."""
        return self._parts.intake.take_samples(valve, samples)

    @changes_state
    def wait_no_longer(self, valves: Times) -> ByValve:
        """Flush the reorder buffer of these valves; return the samples as `take` does."""
        return self._parts.intake.wait_no_longer(valves)

    @changes_state
    def begin_source_anew(self, valves: Times, started: int) -> ByValve:
        """Reset the alignment of these valves: the running numbers of their source restart."""
        return self._parts.intake.begin_source_anew(valves, started)

    @changes_state
    def note_source(self, valve: int, words: tuple[str, ...]) -> None:
        """Note what the source says of a valve's nodes; shown as `waited_for` and by its alarms."""
        self._parts.results.reasons.note_source(valve, words)
        fleet, m = self._parts.valves.at(valve)
        fleet.alarms.note_source(m, "; ".join(words))

    @changes_state
    def note_dynamics(self, valve: int, found: DynamicsResults) -> None:
        """Note the dynamics of one valve; its results show them from now on."""
        self._parts.results.note_dynamics(valve, self._parts.leads.noted(valve, found))

    @changes_state
    def judge_dynamics(self, valve: int, outcome: Outcome, t: int) -> None:
        """Compare a fit of samples up to ``t`` (UTC ns) with the valve's reference, and note it."""
        found = self._parts.references.judge(valve, outcome, t)
        self._parts.results.note_dynamics(valve, self._parts.leads.noted(valve, found))

    def timing(self, valve: int) -> tuple[str, ...]:
        """Describe how each of a valve's signals is stamped."""
        return self._parts.arrivals.how_signals_come(valve, self.plans[valve].nodes)

    def descriptions(self) -> tuple[ValveDescription, ...]:
        """Return the descriptions of all valves for a results server."""
        return descriptions(self.plans)

    def predict(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, Status]:
        """Q (l/min), its standard deviation and status at one point."""
        return self._parts.commands.predict(valve, estimator, U, dp, T)

    def predict_measurement(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, float, Status]:
        """Q, the 95 % interval of a new measurement (l/min), and status."""
        return self._parts.commands.predict_measurement(valve, estimator, U, dp, T)

    def invert(self, valve: str, Q: float, dp: float, T: float) -> Inversion:
        """U for a demanded flow at a pressure drop; of a line, signed."""
        number = self._parts.valves.numbers[valve]
        if self._parts.lines.is_line(number):
            return self._parts.lines.invert(number, Q, dp, T).as_inversion()
        return self._parts.commands.invert(valve, Q, dp, T)

    def compare(self, valve: str, estimator: str) -> Difference:
        """Return the difference of an estimator's map from the baseline's."""
        return self._parts.approved.compare(valve, estimator)

    def predict_approved(
        self, valve: str, estimator: str, U: float, dp: float, T: float
    ) -> tuple[float, float, Status]:
        """Q (l/min), its standard deviation and status at one point of the approved map."""
        return self._parts.approved.predict(valve, estimator, U, dp, T)

    def baseline(self, valve: int) -> Baseline | None:
        """Return the approved map, or None."""
        return self._parts.approved.baselines.get(valve)

    def alarmed(self) -> list[str]:
        """Return the valves that have ever had an active alarm."""
        return self._parts.alarms.alarmed()

    def alarms(self, valve: str | None) -> tuple[AlarmReport, ...]:
        """Return the state of all alarms of a valve or (None) of the service."""
        return self._parts.alarms.reports(valve)

    @changes_state
    def was_away(self) -> None:
        """Note an outage of the service: silence until now is no loss of the sensors."""
        self._parts.alarms.was_away()

    @noted_call
    def say_overdue(self, valves: Times, now: Times) -> list[int]:
        """Note that these valves are silent until ``now``; return those with a new alarm.

        How long they have been silent is no reason to save their states again.
        """
        return self._parts.alarms.say_overdue(valves, now)

    @noted_call
    def watch_service(
        self,
        now: int,
        checkpoint_age_s: float,
        days_left: float,
        load: float,
        history_waits_s: float = math.nan,
    ) -> tuple[AlarmReport, ...]:
        """Update the service's alarms: age of the checkpoints, certificate, load, history."""
        return self._parts.alarms.watch_service(
            now, checkpoint_age_s, days_left, load, history_waits_s
        )

    @changes_state
    def lead(self, valve: str, *, by_another: bool) -> None:
        """Note whether something else writes to the valve; if so, it cannot be armed."""
        self._parts.armed.lead(valve, by_another=by_another)

    @changes_state
    def note_feed_forward(self, valve: int, status: FeedForwardStatus) -> None:
        """Set the feed-forward status to publish."""
        self._parts.armed.note(valve, status)

    @changes_state
    def restore(self, checkpoints: Sequence[Checkpoint]) -> tuple[list[str], dict[str, str]]:
        """Restore the checkpoints that fit, see :meth:`KeptStates.restore`."""
        return self._parts.kept.restore(checkpoints)

    @changes_state
    def remember(
        self, columns: Sequence[Columns], baselines: Mapping[str, bytes]
    ) -> set[tuple[str, str]]:
        """Restore columns and baselines; return (key, valve) of the states that were reset."""
        return self._parts.columns.remember(columns, baselines)
