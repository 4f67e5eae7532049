"""Alarms of a valve: quantities derived from its samples and estimators, against limits. Pure.

=============  ======================================================  =========================
alarm          quantity                                                default limit
=============  ======================================================  =========================
Changed        size of a detected change of the flow                   0.25 % of the flow's range
Residual       residuals, relative to their usual size at these cells  2.5
Misfit         residuals of a structure that does not fit              1 % of the flow's range
SensorLost     time without a usable sample                            2 s
SensorFrozen   time that a sensor's value is constant, others move     10 s
Unexcited      time without informative inputs                         a day
Extrapolated   the answer to the standing demand is extrapolated       yes
SamplesLost    share of recent samples that were lost                  1 %
LagFound       estimated lag of a signal                               0.1 s
LaneFailed     estimators that stopped at an unexpected error          0.5
=============  ======================================================  =========================

An alarm becomes active when its limit was exceeded for ``delay_s``, and inactive when the quantity
falls below the limit less the hysteresis. A change stays active until an operator acknowledges it.
Time is the samples' time, so the same recording gives the same alarms. Changed, Misfit,
SamplesLost, LagFound and Extrapolated are judged at the end of each batch, all others sample by
sample.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from valvemap.model.samples import Codes, Flags, Floats, Samples, Segments, Times, Trace
from valvemap.pipeline.alarm_states import AlarmRule, AlarmStates
from valvemap.pipeline.kernels import alarms as kernel
from valvemap.pipeline.kernels.alarms import Senses, Watched
from valvemap.pipeline.lane_failures import MOST_OF_A_REASON, CopyBuffer, Restore, saved
from valvemap.pipeline.quantity_alarms import KeptAlarms, QuantityAlarms, check_layout, limits_of
from valvemap.pipeline.results import AlarmReport, Remark
from valvemap.vocabulary.service_alarms import OF_FLEET, OF_SERVE, ServiceAlarm
from valvemap.vocabulary.signals import COUNT
from valvemap.vocabulary.statuses import Adaptation

LOSS_MEMORY_S = 60.0  # s; time constant of the share of lost samples
ENOUGH_SAMPLES = 100.0  # samples, lost or not; with fewer the share is not judged
SHOWN_BEFORE_NS, SHOWN_WITHIN_NS = 1_000_000_000, 20_000_000_000  # ns; window of confirmation
CLEAR_CHANGE = 2.5  # times the usual residual; a smaller change is one of the map
LAG_MOVED_S, LAG_MOVED_SHARE = 0.004, 0.15  # s, and share; a larger move changes the residuals
DAY_S = 86_400.0


class Alarm(IntEnum):
    """Alarms of a valve."""

    CHANGED = 0
    RESIDUAL = 1
    MISFIT = 2
    SENSOR_LOST = 3
    SENSOR_FROZEN = 4
    UNEXCITED = 5
    EXTRAPOLATED = 6
    SAMPLES_LOST = 7
    LAG_FOUND = 8
    LANE_FAILED = 9

    @property
    def title(self) -> str:
        """Name in configuration and node ids."""
        return "".join(part.capitalize() for part in self.name.split("_"))


ALARM_NAMES = tuple(alarm.title for alarm in Alarm)


RULES: Mapping[Alarm, AlarmRule] = {
    Alarm.CHANGED: AlarmRule(limit=0.25, hysteresis=0.0, delay_s=0.0, severity=600),
    Alarm.RESIDUAL: AlarmRule(limit=2.5, hysteresis=0.8, delay_s=2.0, severity=500),
    Alarm.MISFIT: AlarmRule(limit=1.0, hysteresis=0.3, delay_s=60.0, severity=300),
    Alarm.SENSOR_LOST: AlarmRule(limit=2.0, hysteresis=0.0, delay_s=0.0, severity=800),
    Alarm.SENSOR_FROZEN: AlarmRule(limit=10.0, hysteresis=0.0, delay_s=0.0, severity=700),
    Alarm.UNEXCITED: AlarmRule(limit=DAY_S, hysteresis=0.0, delay_s=0.0, severity=100),
    Alarm.EXTRAPOLATED: AlarmRule(limit=0.5, hysteresis=0.0, delay_s=5.0, severity=300),
    Alarm.SAMPLES_LOST: AlarmRule(limit=1.0, hysteresis=0.5, delay_s=0.0, severity=400),
    Alarm.LAG_FOUND: AlarmRule(limit=0.1, hysteresis=0.02, delay_s=0.0, severity=300),
    Alarm.LANE_FAILED: AlarmRule(limit=0.5, hysteresis=0.0, delay_s=0.0, severity=800),
}
_RULES_OF_SERVICE: Mapping[ServiceAlarm, AlarmRule] = {
    ServiceAlarm.CHECKPOINT: AlarmRule(limit=60.0, hysteresis=0.0, delay_s=0.0, severity=700),
    ServiceAlarm.CERTIFICATE: AlarmRule(limit=30.0, hysteresis=0.0, delay_s=0.0, severity=500),
    ServiceAlarm.LOAD: AlarmRule(limit=0.9, hysteresis=0.2, delay_s=30.0, severity=600),
    ServiceAlarm.MESSAGES_REJECTED: AlarmRule(limit=0.5, hysteresis=0.0, delay_s=0.0, severity=600),
    ServiceAlarm.HISTORY: AlarmRule(limit=10.0, hysteresis=0.0, delay_s=0.0, severity=500),
}
SERVICE_RULES = {alarm: _RULES_OF_SERVICE[alarm] for alarm in OF_SERVE}
FLEET_RULES = {alarm: _RULES_OF_SERVICE[alarm] for alarm in OF_FLEET}


@dataclass(frozen=True)
class _Kept(KeptAlarms):
    """One valve's alarms as stored in a checkpoint, with the statistics that judge them."""

    last: Any
    still: Any
    longest: Any
    moves: Any
    others: Any
    weight: Any
    bias: Any
    square: Any
    sums: Any
    memory: Any
    times: Any
    reason: Any


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
    states : AlarmStates
        Which are active, acknowledged and confirmed, and operators' comments.

    Examples
    --------
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
        self._senses = _nothing_seen(M)
        self._patient = np.zeros(M, np.bool_)
        self._reasons = np.zeros(M, f"<U{MOST_OF_A_REASON}")
        self._of_source: dict[int, str] = {}
        self._written = *self._arrays().values(), self._patient  # by a step

    @property
    def version(self) -> Times:
        """Number of changes of each valve's alarms (M,)."""
        return self._conditions.version

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
        shares = np.empty(kernel.CAUSES)
        kernel.watch(
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
        memory[chosen, kernel.CHANGES_SEEN] = np.minimum(
            memory[chosen, kernel.CHANGES_SEEN], counts
        )
        if not weighed:
            settled = memory[chosen, kernel.USUAL_N] >= kernel.SETTLED_BLOCKS
            memory[chosen[~settled], kernel.CHANGES_SEEN] = counts[~settled]
        unseen = counts > memory[chosen, kernel.CHANGES_SEEN]
        if not weighed:
            active = self._conditions.active[chosen, Alarm.CHANGED]
            unseen &= self._is_shown(chosen, t, size) | active
        detail[chosen, Alarm.CHANGED, 1] = counts
        x = np.where(unseen, 100.0 * np.abs(size) / self._Q_span, 0.0)
        came = self._move_on(chosen, Alarm.CHANGED, x, t)
        if came.any():
            detail[chosen[came], Alarm.CHANGED, 0] = size[came]
            new = chosen[came]
            shares = np.empty(kernel.CAUSES)
            kernel.name_causes(new, int(Alarm.CHANGED), self._conditions, self._senses, shares)

    def _is_shown(self, chosen: Times, t: Times, size: Floats) -> Flags:
        """Whether residuals confirm changes at ``t`` of this size (K,)."""
        memory, times = self._senses.memory, self._senses.times[chosen]
        shown = times[:, kernel.LARGE_UNTIL] >= t - SHOWN_BEFORE_NS
        shown &= times[:, kernel.LARGE_SINCE] <= t + SHOWN_WITHIN_NS
        shown &= size**2 >= CLEAR_CHANGE**2 * memory[chosen, kernel.USUAL_SQUARE]
        return np.asarray(shown)

    def note_lags(self, chosen: Times, lags: Floats) -> None:
        """Update with the largest lag of K valves, s; NaN if lags are not estimated.

        If it moves, the usual residuals are estimated again: the map may be reset, too.
        """
        before = self._senses.memory[chosen, kernel.LAG_BEFORE]
        moved = np.abs(lags - before) > np.maximum(LAG_MOVED_S, LAG_MOVED_SHARE * before)
        self._senses.memory[chosen, kernel.LAG_BEFORE] = lags
        for m in chosen[moved].tolist():
            self.forget_usual(m)
        self._move_on(chosen, Alarm.LAG_FOUND, lags)

    def note_misfit(self, chosen: Times, adaptation: Codes, rmse: Floats) -> None:
        """Update with the adaptation status and the RMS residual, l/min, of K valves."""
        misfits = adaptation == Adaptation.MISFIT
        x = np.where(misfits, 100.0 * rmse / self._Q_span, 0.0)
        self._move_on(chosen, Alarm.MISFIT, x)

    def note_losses(self, chosen: Times, lost: Times, taken: Times) -> None:
        """Update with the numbers of lost and accepted samples of K valves since the start."""
        memory, times = self._senses.memory[chosen], self._senses.times[chosen]
        now, before = times[:, kernel.NEWEST], times[:, kernel.LOSS_TIME]
        first = before == kernel.NEVER
        before = np.where(first, now, before)
        share = np.exp(-np.clip((now - before) * 1e-9, 0.0, 1e6) / LOSS_MEMORY_S)
        for sum_, last, count in (
            (kernel.LOST, kernel.LOST_BEFORE, lost),
            (kernel.TAKEN, kernel.TAKEN_BEFORE, taken),
        ):
            new = np.where(first, 0.0, np.maximum(count - memory[:, last], 0.0))
            memory[:, sum_] = share * memory[:, sum_] + new
            memory[:, last] = count
        self._senses.memory[chosen] = memory
        self._senses.times[chosen, kernel.LOSS_TIME] = now
        total = memory[:, kernel.LOST] + memory[:, kernel.TAKEN]
        known = total >= ENOUGH_SAMPLES
        x = np.where(known, 100.0 * memory[:, kernel.LOST] / np.maximum(total, 1.0), 0.0)
        self._move_on(chosen, Alarm.SAMPLES_LOST, x)

    def note_answers(self, chosen: Times, guessed: Floats) -> None:
        """Update with whether the answers to K valves' standing demands are extrapolated."""
        self._move_on(chosen, Alarm.EXTRAPOLATED, guessed)

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
        now = np.maximum(self._senses.times[one, kernel.NEWEST], max(t, 1))
        self._step(one, Alarm.LANE_FAILED, x, now, now)

    def stopped_whole(self, m: int) -> bool:
        """Whether the last error of one valve was raised in a step of the whole valve."""
        return bool(self._conditions.detail[m, Alarm.LANE_FAILED, 0])

    def failures(self) -> Times:
        """Number of lane failures (M,)."""
        return self._conditions.detail[:, Alarm.LANE_FAILED, 1].astype(np.int64)

    def saved(self, members: Times, buffer: CopyBuffer) -> Restore:
        """Copy the alarms of the given valves; the result writes the copies back."""
        return saved(self._written, members, buffer)

    def overdue(self, chosen: Times, now: Times) -> None:
        """Update K valves that have sent no sample until ``now``, UTC ns by their sources."""
        usable = self._senses.times[chosen, kernel.USABLE]
        began = np.where(usable == kernel.NEVER, 0, usable)
        waited = np.where(usable == kernel.NEVER, np.inf, (now - began) * 1e-9)
        began = np.where(usable == kernel.NEVER, now, began)
        self._step(chosen, Alarm.SENSOR_LOST, waited, now, began)

    def note_passed(self, chosen: Times, first: Times, last: Times) -> None:
        """Note good samples of K valves, ``first`` to ``last`` (K,), not learnt from."""
        self._step(chosen, Alarm.SENSOR_LOST, np.zeros(len(chosen)), first, first)
        usable = self._senses.times[chosen, kernel.USABLE]
        self._senses.times[chosen, kernel.USABLE] = np.maximum(usable, last)

    def acknowledge(self, m: int, alarm: Alarm, remark: Remark) -> bool:
        """Acknowledge an alarm; False if there was nothing to acknowledge."""
        taken = self.states.acknowledge(m, alarm, remark)
        if taken and alarm is Alarm.CHANGED:
            conditions = self._conditions
            seen = conditions.detail[m, alarm, 1]
            self._senses.memory[m, kernel.CHANGES_SEEN] = seen
            conditions.active[m, alarm], conditions.over[m, alarm] = False, 0
        return taken

    def was_away(self) -> None:
        """Restart the timers after an outage of the service: its silence is no loss of samples."""
        times = self._senses.times
        times[:, [kernel.NEWEST, kernel.USABLE, kernel.LOSS_TIME]] = kernel.NEVER

    def forget_map(self, m: int) -> None:
        """Reset the usual residuals and the change alarm, after a reset of the map."""
        self.forget_usual(m)
        self._move_on(np.array([m]), Alarm.CHANGED, np.zeros(1))

    def forget_usual(self, m: int) -> None:
        """Reset the usual residuals, when those of another estimator are watched."""
        fresh = _nothing_seen(1)
        kept = [kernel.T_USUAL, kernel.CHANGES_SEEN, kernel.LAG_BEFORE, *_LOSSES]
        fresh.memory[0, kept] = self._senses.memory[m, kept]
        for name in ("memory", "weight", "bias", "square", "sums"):
            getattr(self._senses, name)[m] = getattr(fresh, name)[0]
        self._move_on(np.array([m]), Alarm.RESIDUAL, np.zeros(1))

    def reports(self, m: int) -> tuple[AlarmReport, ...]:
        """Return the state of every alarm of one valve, in words."""
        reasons = [self._of_source.get(m, "")] * len(Alarm)
        reasons[Alarm.LANE_FAILED] = str(self._reasons[m])
        return self.states.reports(m, reasons)

    def to_bytes(self, m: int) -> bytes:
        """Pack one valve's alarms and their statistics, without the losses of the last minute."""
        kept = {name: array[m].copy() for name, array in self._arrays().items()}
        kept["memory"][_LOSSES], kept["times"][kernel.LOSS_TIME] = 0.0, kernel.NEVER
        kept["reason"] = np.array(self._reasons[m])
        return _Kept(**kept, remarks=self.states.remarks_to_bytes(m)).to_bytes(_KEY)

    def from_bytes(self, m: int, data: bytes) -> None:
        """Unpack one valve's alarms.

        Raises
        ------
        StateMismatchError
            if the bytes are damaged, or their layout differs from the present one.
        """
        kept = _Kept.from_bytes(data, _KEY)
        arrays = self._arrays()
        check_layout(kept, arrays)
        self.states.remarks_from_bytes(m, kept.remarks)
        for name, array in arrays.items():
            array[m] = getattr(kept, name)
        self._reasons[m] = str(kept.reason)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return all arrays of the alarms and their statistics, each (M, …), not copied."""
        return {**self._arrays(), "patient": self._patient, "reasons": self._reasons}

    def _arrays(self) -> dict[str, NDArray[Any]]:
        return {**self.states.arrays(), **self._senses._asdict()}

    def _move_on(self, chosen: Times, alarm: Alarm, x: Floats, began: Times | None = None) -> Flags:
        t = np.maximum(self._senses.times[chosen, kernel.NEWEST], 0)
        return self._step(chosen, alarm, x, t, t if began is None else began)

    def _step(self, chosen: Times, alarm: Alarm, x: Floats, t: Times, began: Times) -> Flags:
        x = np.ascontiguousarray(x, np.float64)
        came = np.empty(len(x), np.bool_)
        kernel.move_on(chosen, t, began, x, int(alarm), self._limits, self._conditions, came)
        return came


class ServiceAlarms(QuantityAlarms[ServiceAlarm]):
    """The alarms of the service itself; the quantity of Certificate is the days left, negated.

    Parameters
    ----------
    rules
        The alarms that this service has, with the rule of each.

    Examples
    --------
    >>> alarms = ServiceAlarms()
    >>> alarms.note(1_800_000_000_000_000_000, {ServiceAlarm.CHECKPOINT: 90.0})
    >>> [report.name for report in alarms.reports() if report.active]
    ['Checkpoint']
    """

    def __init__(self, rules: Mapping[ServiceAlarm, AlarmRule] = SERVICE_RULES) -> None:
        super().__init__(rules, falls=(ServiceAlarm.CERTIFICATE,))


_LOSSES = [kernel.LOST, kernel.TAKEN, kernel.LOST_BEFORE, kernel.TAKEN_BEFORE]
_KEY = f"alarms 2: {' '.join(ALARM_NAMES)}"


def _nothing_seen(M: int) -> Senses:
    signals, places = (M, COUNT), (M, kernel.CELLS_U * kernel.CELLS_S)
    memory = np.zeros((M, kernel.MEMORY))
    memory[:, kernel.CELL] = -1.0
    memory[:, [kernel.T_USUAL, kernel.Q_BEFORE]] = np.nan
    sums = kernel.DIRECTIONS + 1
    return Senses(
        last=np.full(signals, np.nan),
        still=np.zeros(signals, np.int64),
        longest=np.zeros(signals, np.int64),
        moves=np.zeros(signals, np.int64),
        others=np.zeros(signals, np.int64),
        weight=np.zeros(places, np.float32),
        bias=np.zeros(places, np.float32),
        square=np.zeros(places, np.float32),
        sums=np.zeros((M, sums, sums)),
        memory=memory,
        times=np.full((M, kernel.TIMES), kernel.NEVER),
    )
