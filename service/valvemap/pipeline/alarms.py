"""The alarms of valves: quantities of their samples and estimators against limits. Pure.

The alarms and their rules are in :mod:`~valvemap.pipeline.alarm_rules`. Time is the samples' time,
so the same recording gives the same alarms. Changed, Misfit, SamplesLost, LagFound and Extrapolated
are judged at the end of each batch, all others sample by sample.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Codes, Flags, Floats, Samples, Segments, Times, Trace
from valvemap.pipeline.alarm_results import AlarmReport, Remark
from valvemap.pipeline.alarm_rules import ALARM_NAMES, Alarm
from valvemap.pipeline.alarm_states import AlarmRule, AlarmStates
from valvemap.pipeline.alarm_statistics import (
    forget_usual,
    have_moved,
    is_shown,
    nothing_seen,
    share_lost,
)
from valvemap.pipeline.kernels import alarm_layout as layout
from valvemap.pipeline.kernels.alarm_causes import name_causes
from valvemap.pipeline.kernels.alarm_layout import Watched
from valvemap.pipeline.kernels.alarm_residuals import SETTLED_BLOCKS
from valvemap.pipeline.kernels.alarm_steps import move_on
from valvemap.pipeline.kernels.alarms import watch
from valvemap.pipeline.lane_failures import MOST_OF_A_REASON
from valvemap.pipeline.packed_alarms import pack, unpack
from valvemap.pipeline.quantity_alarms import limits_of
from valvemap.vocabulary.statuses import Adaptation


class Alarms:
    """The alarms of M valves that share a plan; their state is updated in place.

    Parameters
    ----------
    M
        Number of valves.
    rules
        Limit, hysteresis, delay and severity of each alarm.
    Q_span
        Range of the flow, l/min.

    Attributes
    ----------
    written : tuple of arrays
        All that a step writes, each (M, …).
    judged : tuple of arrays
        All that alarms write which are judged by a quantity alone, each (M, …).
    states : AlarmStates
        Which are active, acknowledged and confirmed, and operators' comments.

    Examples
    --------
    >>> from valvemap.pipeline.alarm_rules import RULES
    >>> alarms = Alarms(1, RULES, 200.0)
    >>> alarms.overdue(np.array([0]), np.array([5_000_000_000]))
    >>> [report.name for report in alarms.reports(0) if report.active]
    ['SensorLost']
    """

    def __init__(self, M: int, rules: Mapping[Alarm, AlarmRule], Q_span: float) -> None:
        by_number = [rules[alarm] for alarm in Alarm]
        self._limits = limits_of(by_number)
        self._Q_span = Q_span
        self.states = AlarmStates(M, ALARM_NAMES, by_number)
        self._conditions = self.states.conditions
        self._senses = nothing_seen(M)
        self._patient = np.zeros(M, np.bool_)
        self._reasons = np.zeros(M, f"<U{MOST_OF_A_REASON}")
        self._of_source: dict[int, str] = {}
        self.written = *self._arrays().values(), self._patient
        senses = self._senses
        self.judged = *self._conditions, senses.memory, senses.times, self._patient

    @property
    def version(self) -> Times:
        """Number of changes of each valve's alarms (M,)."""
        return self._conditions.version

    def begun(self, chosen: Times) -> tuple[int, int]:
        """Return numbers that differ once an alarm of K valves, or its delay, begins or ends."""
        conditions = self._conditions
        return int(conditions.version[chosen].sum()), int(conditions.over[chosen].sum())

    def watch(self, samples: Samples, trace: Trace, segments: Segments) -> None:
        """Update with gated samples and the watched estimator's trace of them."""
        seen = Watched(
            samples.t,
            samples.values,
            samples.quality,
            trace.predicted,
            trace.residual,
            trace.status,
        )
        shares = np.empty(layout.CAUSES)
        watch(
            seen,
            self._patient,
            self._limits,
            self._conditions,
            self._senses,
            segments,
            self._Q_span,
            shares,
        )

    def be_patient(self, chosen: Times, patient: Flags) -> None:
        """Set which valves have on-change signals: their silence is no loss."""
        self._patient[chosen] = patient

    def note_changes(
        self, chosen: Times, counts: Times, t: Times, size: Floats, *, weighed: bool = False
    ) -> None:
        """Update with the number of detected flow changes of K valves, and the newest of each.

        A change that the estimator ``weighed`` against other causes is certain, however new the
        map is. Of others, one while the map is new may be the map's convergence, and one that
        residuals do not confirm is one of the estimate, not of the valve.
        """
        memory, detail = self._senses.memory, self._conditions.detail
        memory[chosen, layout.CHANGES_SEEN] = np.minimum(
            memory[chosen, layout.CHANGES_SEEN], counts
        )
        if not weighed:
            settled = memory[chosen, layout.USUAL_N] >= SETTLED_BLOCKS
            memory[chosen[~settled], layout.CHANGES_SEEN] = counts[~settled]
        unseen = counts > memory[chosen, layout.CHANGES_SEEN]
        if not weighed:
            active = self._conditions.active[chosen, Alarm.CHANGED]
            unseen &= is_shown(self._senses, chosen, t, size) | active
        detail[chosen, Alarm.CHANGED, 1] = counts
        x = np.where(unseen, 100.0 * np.abs(size) / self._Q_span, 0.0)
        came = self._move_on(chosen, Alarm.CHANGED, x, t)
        if came.any():
            detail[chosen[came], Alarm.CHANGED, 0] = size[came]
            new = chosen[came]
            shares = np.empty(layout.CAUSES)
            name_causes(new, int(Alarm.CHANGED), self._conditions, self._senses, shares)

    def note_lags(self, chosen: Times, lags: Floats) -> None:
        """Update with the largest lag of K valves, s; NaN if lags are not estimated.

        If it moves, the usual residuals are estimated again: the map may be reset, too.
        """
        for m in chosen[have_moved(self._senses, chosen, lags)].tolist():
            self.forget_usual(m)
        self._move_on(chosen, Alarm.LAG_FOUND, lags)

    def note_misfit(self, chosen: Times, adaptation: Codes, rmse: Floats) -> None:
        """Update with the adaptation status and the RMS residual, l/min, of K valves."""
        misfits = adaptation == Adaptation.MISFIT
        x = np.where(misfits, 100.0 * rmse / self._Q_span, 0.0)
        self._move_on(chosen, Alarm.MISFIT, x)

    def note_losses(self, chosen: Times, lost: Times, taken: Times) -> None:
        """Update with the numbers of lost and accepted samples of K valves since the start."""
        self._move_on(chosen, Alarm.SAMPLES_LOST, share_lost(self._senses, chosen, lost, taken))

    def note_answers(self, chosen: Times, guessed: Floats) -> None:
        """Update with whether the answers to K valves' standing demands are extrapolated."""
        self._move_on(chosen, Alarm.EXTRAPOLATED, guessed)

    def have_guessed(self, chosen: Times) -> bool:
        """Whether one of K valves waits for `note_answers` that an answer is no guess any more."""
        over = self._conditions.over[chosen, Alarm.EXTRAPOLATED]
        return bool((over | self._conditions.active[chosen, Alarm.EXTRAPOLATED]).any())

    def note_source(self, m: int, words: str) -> None:
        """Note what the source says of a valve's nodes, for the texts of its alarms."""
        self._of_source[m] = words
        self.version[m] += bool(self._conditions.active[m].any())

    def note_failure(self, m: int, reason: str, *, whole: bool) -> None:
        """Note the reason why a lane of one valve stopped, or (``whole``) all of them."""
        detail = self._conditions.detail[m, Alarm.LANE_FAILED]
        detail[:] = whole, detail[1] + 1.0
        self._reasons[m] = reason
        self._conditions.version[m] += 1

    def note_stopped(self, m: int, lanes: int, t: int) -> None:
        """Note the number of stopped lanes of one valve; ``t``: time of its last sample, UTC ns."""
        x, one = np.array([float(lanes)]), np.array([m])
        now = np.maximum(self._senses.times[one, layout.NEWEST], max(t, 1))
        self._step(one, Alarm.LANE_FAILED, x, now, now)

    def stopped_whole(self, m: int) -> bool:
        """Whether the last error of one valve was raised in a step of the whole valve."""
        return bool(self._conditions.detail[m, Alarm.LANE_FAILED, 0])

    def failures(self, chosen: Times) -> Times:
        """Number of lane failures of K valves (K,)."""
        found: Times = self._conditions.detail[chosen, Alarm.LANE_FAILED, 1].astype(np.int64)
        return found

    def overdue(self, chosen: Times, now: Times) -> None:
        """Update K valves that have sent no sample until ``now``, UTC ns by their sources."""
        usable = self._senses.times[chosen, layout.USABLE]
        began = np.where(usable == layout.NEVER, 0, usable)
        waited = np.where(usable == layout.NEVER, np.inf, (now - began) * 1e-9)
        began = np.where(usable == layout.NEVER, now, began)
        self._step(chosen, Alarm.SENSOR_LOST, waited, now, began)

    def note_passed(self, chosen: Times, first: Times, last: Times) -> None:
        """Note good samples of K valves, ``first`` to ``last`` (K,), not learnt from."""
        self._step(chosen, Alarm.SENSOR_LOST, np.zeros(len(chosen)), first, first)
        usable = self._senses.times[chosen, layout.USABLE]
        self._senses.times[chosen, layout.USABLE] = np.maximum(usable, last)

    def acknowledge(self, m: int, alarm: Alarm, remark: Remark) -> bool:
        """Acknowledge an alarm; False if there was nothing to acknowledge."""
        taken = self.states.acknowledge(m, alarm, remark)
        if taken and alarm is Alarm.CHANGED:
            conditions = self._conditions
            seen = conditions.detail[m, alarm, 1]
            self._senses.memory[m, layout.CHANGES_SEEN] = seen
            conditions.active[m, alarm], conditions.over[m, alarm] = False, 0
        return taken

    def was_away(self) -> None:
        """Restart the timers after an outage of the service: its silence is no loss of samples."""
        times = self._senses.times
        times[:, [layout.NEWEST, layout.USABLE, layout.LOSS_TIME]] = layout.NEVER

    def forget_map(self, m: int) -> None:
        """Reset the usual residuals and the change alarm, after a reset of the map."""
        self.forget_usual(m)
        self._move_on(np.array([m]), Alarm.CHANGED, np.zeros(1))

    def forget_usual(self, m: int) -> None:
        """Reset the usual residuals, when those of another estimator are watched."""
        forget_usual(self._senses, m)
        self._move_on(np.array([m]), Alarm.RESIDUAL, np.zeros(1))

    def reports(self, m: int) -> tuple[AlarmReport, ...]:
        """Return the state of every alarm of one valve, in words."""
        reasons = [self._of_source.get(m, "")] * len(Alarm)
        reasons[Alarm.LANE_FAILED] = str(self._reasons[m])
        return self.states.reports(m, reasons)

    def to_bytes(self, m: int) -> bytes:
        """Pack one valve's alarms and their statistics, without the losses of the last minute."""
        row = {name: array[m] for name, array in self._arrays().items()}
        return pack(row, str(self._reasons[m]), self.states.remarks_to_bytes(m))

    def from_bytes(self, m: int, data: bytes) -> None:
        """Unpack one valve's alarms.

        Raises
        ------
        StateMismatchError
            if the bytes are damaged, or their layout differs from the present one.
        """
        arrays = self._arrays()
        row, reason, remarks = unpack(data, arrays)
        self.states.remarks_from_bytes(m, remarks)
        for name, array in arrays.items():
            array[m] = row[name]
        self._reasons[m] = reason

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return all arrays of the alarms and their statistics, each (M, …), not copied."""
        return {**self._arrays(), "patient": self._patient, "reasons": self._reasons}

    def _arrays(self) -> dict[str, NDArray[Any]]:
        return {**self.states.arrays(), **self._senses._asdict()}

    def _move_on(self, chosen: Times, alarm: Alarm, x: Floats, began: Times | None = None) -> Flags:
        t = np.maximum(self._senses.times[chosen, layout.NEWEST], 0)
        return self._step(chosen, alarm, x, t, t if began is None else began)

    def _step(self, chosen: Times, alarm: Alarm, x: Floats, t: Times, began: Times) -> Flags:
        x = np.ascontiguousarray(x, np.float64)
        came = np.empty(len(x), np.bool_)
        move_on(chosen, t, began, x, int(alarm), self._limits, self._conditions, came)
        return came
