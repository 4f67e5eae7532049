"""Axes that are identified while they work: samples in, a search for play and spool when due. Pure.

An axis is read as two rows of signals, one for each of its lines: U, the pressures on both sides of
the line's edges, and the position. An axis at rest neither learns nor forgets nor searches: all
times but that of the newest sample are of movement.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from valvemap.model.axis import AxisSamples
from valvemap.model.axis_rest import Rest
from valvemap.model.axis_travel import Travel
from valvemap.model.estimator import StateMismatchError
from valvemap.model.lead import lead_in_words
from valvemap.model.samples import Samples
from valvemap.pipeline.axis_alarms import AxisAlarms
from valvemap.pipeline.axis_demand import AxisDemand, answer
from valvemap.pipeline.axis_learner import AxisLearner
from valvemap.pipeline.axis_memory import NEWEST, AxisMemory, Unmet
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.axis_ports import AxisResults, RequiredU
from valvemap.pipeline.axis_tracking import Tracking
from valvemap.pipeline.edges import MOST_WAITING, NEVER_MET, matched
from valvemap.pipeline.feedforward import Situation
from valvemap.pipeline.kept_axes import ALARMS
from valvemap.vocabulary.statuses import AxisStatus, Quality, Status

_LONGEST_STEP_S: Final = 1.0  # s; a longer step from sample to sample is cut to this


class Axis:
    """One axis; `take` its samples, and do the `learner`'s jobs that are due.

    Parameters
    ----------
    plan
        Its geometry and memory.
    on_samples
        Called with whole samples as soon as they are the newest.
    """

    def __init__(
        self, plan: AxisPlan, on_samples: Callable[[AxisSamples], None] | None = None
    ) -> None:
        self.plan, self._on_samples = plan, on_samples
        self._unmet, self.unpaired = [Unmet.nothing(), Unmet.nothing()], 0
        self._met = np.array([NEVER_MET])  # time of their last match
        self._rest, self._travel = Rest.initial(), Travel.initial()
        self.learner, self._demand = AxisLearner(plan), AxisDemand(plan.feed_forward)
        self.alarms, self._tracking = AxisAlarms(), Tracking()
        self.newest_U = np.nan  # of the newest sample, %
        self._newest: tuple[float, ...] = (np.nan,) * NEWEST  # x, T, pA, pB, pS, pT
        self.t = 0  # of the newest sample, UTC ns

    def take_line(self, line: int, samples: Samples) -> None:
        """Take samples of line A (0) or B (1); they count once the other line's have come."""
        good = samples.quality == Quality.GOOD
        columns = (samples.U, samples.p1, samples.p2, samples.Q, samples.T)
        new = np.where(good, np.stack(columns), np.nan)
        self._unmet[line] = self._unmet[line].and_then(samples.t, new)
        self._meet()

    def _meet(self) -> None:
        A, B = self._unmet
        (rows, of), (past_A, past_B) = matched([A.t, B.t], self._met, MOST_WAITING)
        self._unmet = [A.without(past_A), B.without(past_B)]
        self.unpaired += int(past_A) - len(rows)
        if len(rows):
            t = A.t[rows]
            U, pS, pA, moved, T = A.values[:, rows]
            _, pB, pT, _, set_position = B.values[:, of]
            if self.plan.is_tracked:
                self._tracking.take(t, moved, set_position)
            piston = {"v" if self.plan.has_speed else "x": moved}
            self.take(AxisSamples.of(t, U=U, pA=pA, pB=pB, pS=pS, pT=pT, T=T, **piston))

    def take(self, samples: AxisSamples) -> None:
        """Take whole samples; where the axis rests, they give the present pressures alone.

        Where the speed is measured, the position comes from it.
        """
        if self.plan.has_speed:
            self._travel, samples = self._travel.update(samples, self.plan.geometry.stroke_mm)
        steps_s = 1e-9 * np.diff(samples.t, prepend=self.t or samples.t[0])
        self.t = int(samples.t[-1])
        self.newest_U = float(samples.U[-1])
        newest = (getattr(samples, name)[-1] for name in ("x", "T", "pA", "pB", "pS", "pT"))
        self._newest = tuple(float(value) for value in newest)
        if self._on_samples is not None:
            self._on_samples(samples)
        if self.plan.is_frozen:
            return
        self._rest, moves = self._rest.update(samples)
        if not moves.any():
            return
        passed_s = float(np.clip(steps_s, 0.0, _LONGEST_STEP_S)[moves].sum())
        self.learner.take(samples[moves], passed_s)

    def situation(self) -> Situation:
        """Return what feed-forward goes by, as of an armed axis whose sample has just come."""
        x, _, *pressures = self._newest
        is_whole = np.isfinite([self.newest_U, x, *pressures]).all()
        required = self.required()
        status = Status.WARMING_UP if self.learner.known is None else Status.OK
        return Situation(
            armed=True,
            connected=True,
            age_s=0.0,
            U=self.newest_U,
            map=status if is_whole else Status.REJECTED,
            required_U=required.U,
            width=required.upper - required.lower,
            answer=required.status,
        )

    def demand(self, v: float) -> None:
        """Demand a speed, mm/s; NaN withdraws the demand."""
        self._demand.demand(v, self.t)

    @property
    def lead_s(self) -> float:
        """By how much the demand is advanced, s; 0: it is not, or the map has no spool yet."""
        return self._demand.lead_s(self.learner.known)

    def required(self) -> RequiredU:
        """Return the signal for the demanded speed at the newest sample's pressures."""
        return self._demand.required(self.learner.known, self.t, self._newest)

    def invert(
        self,
        v: float,
        pA: float = np.nan,
        pB: float = np.nan,
        pS: float = np.nan,
        pT: float = np.nan,
        T: float = np.nan,
    ) -> RequiredU:
        """Return the signal for a speed, in the middle of its loop; NaN: the newest sample's."""
        x, *newest = self._newest
        asked = zip((T, pA, pB, pS, pT), newest, strict=True)
        given = (there if np.isnan(one) else one for one, there in asked)
        return answer(self.learner.known, v, (x, *given))

    def results(self) -> AxisResults:
        """Return the present results."""
        used_s, left_out, learner = 0.0, dict[str, int](), self.learner
        if learner.state is not None:
            left_out = learner.state.reasons()
            used_s = left_out.pop("used") * learner.regression.period_s
        status, sentence = AxisStatus.OK, AxisStatus.OK.sentence
        known = None if learner.known is None else learner.known.map
        if known is None:
            status = AxisStatus.TOO_SHORT
            sentence = status.sentence
            if learner.refused is not None:
                status, sentence = learner.refused.status, learner.refused.sentence
                left_out = {k: n for k, n in learner.refused.left_out.items() if k != "used"}
        elif self.plan.feed_forward is not None and self.plan.feed_forward.leads:
            sentence = f"{sentence} {lead_in_words(self.lead_s)}"
        findings = None if learner.watch is None else learner.watch.condition.findings()
        required = self.required()
        return AxisResults(
            status,
            sentence,
            self.t,
            used_s,
            left_out,
            known,
            required,
            findings,
            tracking=self._tracking.course,
        )

    @property
    def key(self) -> str:
        """The hash that a stored state is bound to: by geometry, and what measures the piston."""
        return self.plan.key

    def to_bytes(self) -> dict[str, bytes]:
        """Return alarms, searches, the learnt state, and the reference of findings, if any."""
        found = {ALARMS: self.alarms.to_bytes(self.key)} if self.alarms.version else {}
        return {**found, **self.learner.to_bytes()}

    @property
    def memory(self) -> AxisMemory:
        """What is kept beside what has been learnt."""
        unmet_A, unmet_B = self._unmet
        newest = np.array([self.newest_U, *self._newest])
        return AxisMemory(
            (unmet_A, unmet_B),
            self._met.copy(),
            self._rest,
            self._travel,
            self.t,
            newest,
            self.unpaired,
        )

    def remember(self, memory: AxisMemory) -> None:
        """Continue with this memory."""
        self._unmet, self.unpaired = list(memory.unmet), memory.unpaired
        self._met = memory.met.copy()
        self._rest, self._travel, self.t = memory.rest, memory.travel, memory.t
        self.newest_U, *newest = memory.newest.tolist()
        self._newest = tuple(newest)

    def resume(self, name: str, packed: bytes) -> None:
        """Resume a stored state of this name; the learner's next job gives its map.

        Raises
        ------
        StateMismatchError
            if it is damaged, or of another geometry, or measures another quantity.
        """
        try:
            self._resume(name, packed, self.key)
        except StateMismatchError:
            if not self.plan.former_key:
                raise
            self._resume(name, packed, self.plan.former_key)

    def _resume(self, name: str, packed: bytes, key: str) -> None:
        if name == ALARMS:
            self.alarms.from_bytes(packed, key)
            return
        self.learner.resume(name, packed, key)
