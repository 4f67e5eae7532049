"""Axes that are identified while they work: samples in, a search for play and spool when due. Pure.

An axis is read as two rows of signals, one for each of its lines: U, the pressures on both sides of
the line's edges, and the position. A search over the newest minutes finds play and spool, and takes
seconds: the caller runs it beside everything else, as it does the solution of the sums. Between
two searches the sums continue sample by sample. An axis at rest neither learns nor forgets nor
searches: all times but that of the newest sample are of movement.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from valvemap.model.axis import (
    SPOOL_DAMPING,
    AxisGeometry,
    AxisRegression,
    AxisSamples,
    AxisState,
)
from valvemap.model.axis_basis import SIZE, leakage_share
from valvemap.model.axis_fit import AxisFit, fit, moved, with_map
from valvemap.model.axis_inverse import AxisTable, axis_table, invert
from valvemap.model.axis_rest import Rest
from valvemap.model.axis_search import AxisResult, identify
from valvemap.model.axis_travel import Travel
from valvemap.model.estimator import StateMismatchError, key_of
from valvemap.model.kernels.flow_rules import BETWEEN_JUMPS
from valvemap.model.lead import DemandCourse, lead_in_words, led, spool_delay
from valvemap.model.samples import Floats, Samples
from valvemap.pipeline.axis_alarms import AxisAlarms
from valvemap.pipeline.axis_memory import NEWEST, AxisMemory, Unmet
from valvemap.pipeline.axis_ports import AxisMap, AxisResults, RequiredU
from valvemap.pipeline.axis_searches import Searches
from valvemap.pipeline.axis_tracking import Tracking
from valvemap.pipeline.axis_watch import AxisWatch, Balance, balance
from valvemap.pipeline.axis_window import AxisWindow
from valvemap.pipeline.edges import MOST_WAITING, NEVER_MET, matched
from valvemap.pipeline.feedforward import FeedForward, Situation
from valvemap.pipeline.kept_axes import Learnt, pack, unpack
from valvemap.pipeline.kept_watches import pack_watch, unpack_watch
from valvemap.pipeline.meaning import Meaning
from valvemap.vocabulary.statuses import DELIVERS, AxisStatus, InverseStatus, Quality, Status

LEARNT, SEARCHES, WATCH, ALARMS = "Axis", "AxisSearches", "AxisWatch", "AxisAlarms"
"""Names of the stored parts."""
WINDOW_S: Final = 200.0  # s of movement; length of a search: more does not move play and spool
MOST_SAMPLES: Final = 250_000  # of the window, if samples come very quickly
CHANGES_PER_S: Final = 1.0 / BETWEEN_JUMPS  # 1/s; sudden changes that are expected of an edge
REFIT_S: Final = 5.0  # s of movement between two fits of the sums
SAME_PLAY_PERCENT, SAME_LAG_S = 0.25, 0.003  # up to these differences the sums continue
_RATED_BAR: Final = 70.0
_LONGEST_STEP_S: Final = 1.0  # s; a longer step from sample to sample is cut to this


@dataclass(frozen=True)
class AxisPlan:
    """Configuration of one axis; ``meaning`` is that of its signals, None: unknown.

    ``is_frozen``: the stored map stays as it is; nothing is learnt, nothing is found.
    ``has_speed``: the piston's speed is measured, and not its position. ``is_tracked``: there is a
    set position; line B has it where line A has T. ``former_key``: what states of earlier versions
    are bound to, if they are of this configuration; empty: there are none.
    """

    name: str
    geometry: AxisGeometry
    memory_s: float = 1_800.0
    meaning: Meaning | None = None
    feed_forward: FeedForward | None = None
    is_frozen: bool = False
    has_speed: bool = False
    is_tracked: bool = False
    former_key: str = ""


@dataclass(frozen=True)
class _Bound:
    """What a stored state is valid for, beside the meaning of its signals."""

    geometry: AxisGeometry
    has_speed: bool


@dataclass(frozen=True)
class _Known:
    """The solution of the sums: the fit, the table that is searched, and the map that is shown.

    ``sums`` is the fit of the sums alone, ``fit`` the edges as they are now. ``forces`` is the
    balance of forces, when a watch is to begin.
    """

    sums: AxisFit
    fit: AxisFit
    table: AxisTable
    map: AxisMap
    forces: Balance | None


@dataclass(frozen=True)
class _Weighed:
    """A watch before and after its closed windows were weighed."""

    before: AxisWatch
    after: AxisWatch


Outcome = AxisResult | _Known | _Weighed
Job = Callable[[], Outcome]


class Axis:
    """One axis; `take` its samples, do the `job` that is due, and `accept` what it has found.

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
        self._window = AxisWindow(WINDOW_S, MOST_SAMPLES)
        self._since: list[AxisSamples] | None = None  # while a search runs
        self._works = False
        self._searches, self._to_refit_s = Searches(), REFIT_S
        self._refused: AxisResult | None = None
        self._state: AxisState | None = None
        self._regression = AxisRegression(plan.geometry, has_place=not plan.has_speed)
        self._of_shape: Floats = np.zeros((SIZE, SIZE))
        self._known: _Known | None = None
        self._watch: AxisWatch | None = None
        self.alarms, self._tracking = AxisAlarms(), Tracking()
        self.newest_U = np.nan  # of the newest sample, %
        self._newest: tuple[float, ...] = (np.nan,) * NEWEST  # x, T, pA, pB, pS, pT
        self.t = 0  # of the newest sample, UTC ns
        self._demand, self._course = np.nan, DemandCourse()
        self._held_U = np.nan

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
        samples = samples[moves]
        self._window.append(passed_s, samples)
        self._searches = self._searches.after(passed_s)
        if self._since is not None:
            self._since.append(samples)
        if self._state is not None:
            before = self._state.has_changed
            self._state, _ = self._regression.update(self._state, samples)
            self._to_refit_s -= passed_s
            if self._state.has_changed and not before:
                self._search_anew()
        if self._watch is not None:
            self._watch = self._watch.after(samples)

    def job(self) -> Job | None:
        """Return the work that is due, for another thread; None: there is none, or one is done.

        It changes nothing here: `accept` its outcome, or `abandon` it.
        """
        if self._works:
            return None
        if self._searches.is_due and self._window:
            self._works, self._since = True, []
            plan, window = self.plan, self._window.whole()
            return partial(identify, window, plan.geometry, memory_s=plan.memory_s)
        if self._to_refit_s <= 0.0 and self._state is not None:
            self._works, self._to_refit_s = True, REFIT_S
            newest = self._window.whole() if self._begins_watch and self._window else None
            return partial(_solved, self._regression, self._state, self._of_shape, newest)
        if self._watch is not None and self._watch.closed:
            self._works = True
            return partial(_weighed, self._watch)
        return None

    def accept(self, outcome: Outcome) -> None:
        """Apply the outcome of a job; a refusal changes no map that there is."""
        self._works = False
        if isinstance(outcome, _Known):
            self._known = outcome
            if self._state is not None:
                self._state = with_map(self._state, outcome.sums)
            self._begin_watch(outcome)
            return
        if isinstance(outcome, _Weighed):
            watch, before = self._watch, outcome.before
            if watch is not None and watch.reference is before.reference:
                self._watch = watch.accepted(before, outcome.after)
            return
        since, self._since = self._since or [], None
        if outcome.status or outcome.fit is None or outcome.state is None:
            self._searches, self._refused = self._searches.failed(), outcome
            return
        self._searches, self._refused = self._searches.succeeded(), None
        if outcome.of_shape is not None:
            self._of_shape = outcome.of_shape
        if self._state is None or not _are_alike(self._regression, outcome.fit.regression):
            self._regression = replace(outcome.fit.regression, changes_per_s=CHANGES_PER_S)
            self._state = outcome.state
            for samples in since:
                self._state, _ = self._regression.update(self._state, samples)
        self._to_refit_s = 0.0

    def _begin_watch(self, known: _Known) -> None:
        """Take the map as the reference of findings, once play and spool are settled."""
        if self._begins_watch and self._state is not None:
            of_shape, memory_s = self._of_shape, self.plan.memory_s
            self._watch = AxisWatch.begin(self._state, known.fit, memory_s, of_shape, known.forces)

    @property
    def _begins_watch(self) -> bool:
        return self._watch is None and self._searches.are_settled

    def set_reference(self) -> None:
        """Learn anew; the map stays until there is a new one, findings come after the searches."""
        self._window.clear()
        self._watch = self._state = self._since = None
        self._searches = Searches()

    def _search_anew(self) -> None:
        """Search play and spool in the samples after a sudden change alone."""
        self._window.clear()
        self._searches = self._searches.over_new_samples()

    def abandon(self) -> None:
        """Note that a job ended without an outcome."""
        self._works, self._since, self._searches = False, None, self._searches.abandoned()

    def situation(self) -> Situation:
        """Return what feed-forward goes by, as of an armed axis whose sample has just come."""
        x, _, *pressures = self._newest
        is_whole = np.isfinite([self.newest_U, x, *pressures]).all()
        answer = self.required()
        status = Status.WARMING_UP if self._known is None else Status.OK
        return Situation(
            armed=True,
            connected=True,
            age_s=0.0,
            U=self.newest_U,
            map=status if is_whole else Status.REJECTED,
            required_U=answer.U,
            width=answer.upper - answer.lower,
            answer=answer.status,
        )

    def demand(self, v: float) -> None:
        """Demand a speed, mm/s; NaN withdraws the demand."""
        self._demand, self._course = v, self._course.after(self.t, v)

    @property
    def lead_s(self) -> float:
        """By how much the demand is advanced, s; 0: it is not, or the map has no spool yet."""
        settings = self.plan.feed_forward
        if self._known is None or settings is None or not settings.leads:
            return 0.0
        return spool_delay(self._known.map.spool_hz, SPOOL_DAMPING)

    def required(self) -> RequiredU:
        """Return the signal for the demanded speed at the newest sample's pressures.

        Half the play is added on the side from which U is approached.
        """
        advance = self._course.advance(self.t, self.lead_s)
        answer = led(self.invert, self._demand, advance, lambda found: found.status in DELIVERS)
        if not np.isfinite(answer.U) or self._known is None:
            self._held_U = np.nan
            return answer
        half = 0.5 * self._known.table.play_percent
        held = answer.U if np.isnan(self._held_U) else self._held_U
        self._held_U = float(np.clip(held, answer.U - half, answer.U + half))
        shift = answer.U - self._held_U
        U, lower, upper = (x + shift for x in (answer.U, answer.lower, answer.upper))
        return RequiredU(float(np.clip(U, -100.0, 100.0)), lower, upper, answer.status)

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
        if self._known is None:
            return RequiredU()
        x, newest_T, *newest = self._newest
        asked = zip((pA, pB, pS, pT), newest, strict=True)
        p_A, p_B, p_S, p_T = (there if np.isnan(one) else one for one, there in asked)
        place = None if np.isnan(x) else x
        table = self._known.table
        share = leakage_share(newest_T if np.isnan(T) else T)
        table = replace(table, leakage=share * table.leakage)
        found = invert(table, v, p_A, p_B, p_S, p_T, place)
        U, lower, upper = (float(column[0]) for column in (found.U, found.lower, found.upper))
        return RequiredU(U, lower, upper, InverseStatus(int(found.status[0])))

    def results(self) -> AxisResults:
        """Return the present results."""
        used_s, left_out = 0.0, dict[str, int]()
        if self._state is not None:
            left_out = self._state.reasons()
            used_s = left_out.pop("used") * self._regression.period_s
        status, sentence = AxisStatus.OK, AxisStatus.OK.sentence
        known = None if self._known is None else self._known.map
        if known is None:
            status = AxisStatus.TOO_SHORT
            sentence = status.sentence
            if self._refused is not None:
                status, sentence = self._refused.status, self._refused.sentence
                left_out = {k: n for k, n in self._refused.left_out.items() if k != "used"}
        elif self.plan.feed_forward is not None and self.plan.feed_forward.leads:
            sentence = f"{sentence} {lead_in_words(self.lead_s)}"
        findings = None if self._watch is None else self._watch.condition.findings()
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
        return key_of(_Bound(self.plan.geometry, self.plan.has_speed))

    def to_bytes(self) -> dict[str, bytes]:
        """Return alarms, searches, the learnt state, and the reference of findings, if any."""
        found = {ALARMS: self.alarms.to_bytes(self.key)} if self.alarms.version else {}
        if (learnt := self.learnt) is not None:
            found[LEARNT] = pack(learnt, self.key)
            found[SEARCHES] = self._searches.to_bytes(self.key)
        if self._watch is not None:
            found[WATCH] = pack_watch(self._watch, self.key)
        return found

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

    @property
    def learnt(self) -> Learnt | None:
        """What has been learnt; None: nothing yet."""
        if self._state is None:
            return None
        return Learnt(self._regression, self._state, self._of_shape)

    def continue_from(self, learnt: Learnt) -> None:
        """Continue from this; the next `job` gives its map."""
        self._regression, self._state = learnt.regression, learnt.state
        self._of_shape, self._to_refit_s = learnt.of_shape, 0.0

    def resume(self, name: str, packed: bytes) -> None:
        """Resume a stored state of this name; the next `job` gives its map.

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
        regression = AxisRegression(
            self.plan.geometry,
            memory_s=self.plan.memory_s,
            changes_per_s=CHANGES_PER_S,
            has_place=not self.plan.has_speed,
        )
        if name == ALARMS:
            self.alarms.from_bytes(packed, key)
            return
        if name == SEARCHES:
            self._searches = Searches.from_bytes(packed, key).resumed()
            return
        if name == WATCH:
            self._watch = unpack_watch(packed, key, regression)
            return
        self.continue_from(unpack(packed, key, regression))


def _solved(
    regression: AxisRegression,
    state: AxisState,
    of_shape: Floats,
    window: AxisSamples | None = None,
) -> _Known:
    """Return the solution of a state; with a window, also the balance of forces there."""
    sums = fit(regression, state)
    sums = replace(sums, covariance=sums.covariance + of_shape)
    found = moved(sums, state)
    table = axis_table(found)
    return _Known(
        sums,
        found,
        table,
        AxisMap(
            bulk_modulus=found.bulk_modulus,
            leakage=found.leakage,
            air=found.air,
            play_percent=regression.play_percent,
            spool_hz=regression.spool_hz,
            U=table.y,
            flow=table.flow(_RATED_BAR),
            flow_std=table.spread * np.sqrt(_RATED_BAR),
            known=table.known,
        ),
        None if window is None else balance(found, window),
    )


def _weighed(watch: AxisWatch) -> _Weighed:
    return _Weighed(watch, watch.weighed())


def _are_alike(one: AxisRegression, other: AxisRegression) -> bool:
    return (
        abs(one.play_percent - other.play_percent) <= SAME_PLAY_PERCENT
        and abs(1.0 / one.spool_hz - 1.0 / other.spool_hz) <= SAME_LAG_S
        and abs(one.period_s - other.period_s) < 0.01 * one.period_s
    )
