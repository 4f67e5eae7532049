"""One valve: its plan, its state, and functions of both. Pure."""

from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import chain
from typing import Any, ClassVar, NamedTuple, Self, cast

import numpy as np

from valvemap.model.capabilities import (
    FindsCauses,
    FitsInBursts,
    Forgetful,
    PathDependent,
    ResidualStd,
)
from valvemap.model.contents import Contents
from valvemap.model.estimator import Estimator, State, StateMismatchError, Template, key_of
from valvemap.model.extrapolation import U_range_of, trusted
from valvemap.model.inverse_map import inverse_table, invert
from valvemap.model.inversion import Inversion
from valvemap.model.kernels import lack_of_fit
from valvemap.model.kernels import residual_spread as of_spread
from valvemap.model.lead import led
from valvemap.model.residual_spread import TWO_SIDED_95, ResidualSpread
from valvemap.model.samples import Codes, Floats, Samples
from valvemap.model.sensor_accuracy import EXACT, SensorAccuracy, systematic_std
from valvemap.model.support import Support
from valvemap.model.survey import Survey, survey
from valvemap.pipeline.alarm_states import AlarmRule
from valvemap.pipeline.alarms import RULES, Alarm
from valvemap.pipeline.edges import Part
from valvemap.pipeline.feedforward import FeedForward
from valvemap.pipeline.kernels import score as of_score
from valvemap.pipeline.map_errors import MapErrors
from valvemap.pipeline.meaning import Meaning
from valvemap.pipeline.nameplate import BLANK, Nameplate
from valvemap.pipeline.quality_gate import GateState, QualityGate
from valvemap.pipeline.score import Score
from valvemap.vocabulary.findings import Finding, FindingCode
from valvemap.vocabulary.statuses import DELIVERS, InverseStatus, Status

AnyEstimator = Estimator[Any]

WIDEST = 1e9  # largest ratio of an interval to its root mean square: outliers raise both

_OF_SCORE = [  # never negative
    *(of_score.N, of_score.SQUARES, of_score.SCATTER_Q),
    *(of_score.RECENT, of_score.WEIGHT, of_score.LARGEST),
]


@dataclass(frozen=True)
class ValvePlan:
    """Configuration of one valve: gate, estimators, inverse and alarms.

    ``inverse`` names the estimator whose map is inverted; if ``follows``, the recommended one is,
    once there is one. ``references`` are estimators that are never recommended. ``map_Q`` (l/min)
    and ``map_dp`` (bar) are the axes of the published table. ``feed_forward`` is None if the answer
    is never written to the valve. ``insist`` estimates from implausible data, too. ``accuracy`` is
    that of the sensors, ``nodes`` are their names in messages about missing signals, ``alarms`` the
    rules of the alarms; ``nameplate`` is published only; ``meaning`` is stored with the states.
    ``part`` says which edge or line it is of a valve with ports, ``meter`` the meter that it shares
    with other valves ("": none). ``is_driven``: commissioning runs may drive it.
    """

    name: str
    gate: QualityGate
    estimators: Mapping[str, AnyEstimator]
    inverse: str
    U_range: tuple[float, float] = (0.0, 100.0)
    map_Q: tuple[float, ...] = tuple(float(q) for q in range(0, 201, 10))
    map_dp: tuple[float, ...] = tuple(float(dp) for dp in range(10, 201, 10))
    feed_forward: FeedForward | None = None
    insist: bool = False
    accuracy: SensorAccuracy = EXACT
    nodes: Mapping[str, str] = field(default_factory=dict)
    alarms: Mapping[Alarm, AlarmRule] = field(default_factory=lambda: RULES)
    nameplate: Nameplate = BLANK
    meaning: Meaning | None = None
    follows: bool = False
    references: frozenset[str] = frozenset()
    part: Part | None = None
    meter: str = ""
    is_driven: bool = False


@dataclass(frozen=True)
class Lane:
    """One estimator on one valve, with its state and the operator's settings.

    ``errors`` are those of its map at places left, by which intervals are widened; None: not known.
    """

    estimator: AnyEstimator
    state: State
    score: Score
    spread: ResidualSpread = field(default_factory=ResidualSpread.none)
    support: Support = field(default_factory=Support.none)
    frozen: bool = False
    lam: float | None = None
    count: int = 0
    t: int = 0
    predicted: float = np.nan
    residual: float = np.nan
    status: Status | None = None
    accuracy: SensorAccuracy = EXACT
    errors: MapErrors | None = None


@dataclass(frozen=True)
class ValveState:
    """The whole state of one valve."""

    gate: GateState
    lanes: Mapping[str, Lane]
    t: int = 0
    T: float = np.nan
    demand_Q: float = np.nan
    demand_dp: float = np.nan


def fresh_lane(estimator: AnyEstimator, support: Support | None = None) -> Lane:
    """Return an estimator in its initial state; ``support`` is empty, with the valve's ranges."""
    return Lane(
        estimator, estimator.initial_state(), Score.none(), support=support or Support.none()
    )


def nothing_seen(plan: ValvePlan) -> Support:
    """Return the support of a map before the first sample."""
    return Support.none(plan.U_range, (min(0.0, *plan.map_dp), max(plan.map_dp)), max(plan.map_Q))


def runs_interpreted(estimator: AnyEstimator) -> bool:
    """Whether an update takes milliseconds even if its kernels run interpreted."""
    return not isinstance(estimator, FitsInBursts)


def survey_of(plan: ValvePlan, state: ValveState, name: str) -> Survey:
    """Return the survey of an estimator's map, at the last temperature."""
    lane = state.lanes[name]
    dp_max, Q_max = max(plan.map_dp), max(plan.map_Q)
    return survey(
        lane.estimator, lane.state, lane.spread, state.t, state.T, dp_max=dp_max, Q_max=Q_max
    )


def findings_of(lane: Lane) -> tuple[Finding, ...]:
    """Return the causes that an estimator finds in its samples; empty if it looks for none."""
    if not isinstance(lane.estimator, FindsCauses):
        return ()
    return lane.estimator.findings(lane.state)


def merged_findings(found: Iterable[tuple[Finding, ...]]) -> tuple[Finding, ...]:
    """Return the findings of several estimators, each cause once, the likeliest first."""
    best: dict[FindingCode, Finding] = {}
    for finding in chain.from_iterable(found):
        known = best.get(finding.code)
        if known is None or finding.probability > known.probability:
            best[finding.code] = finding
    return tuple(sorted(best.values(), key=lambda one: (-one.probability, one.code)))


def inverse_map(plan: ValvePlan, state: ValveState) -> Floats:
    """The inverse as a table (len(map_Q), len(map_dp)), %, at the last temperature."""
    lane = state.lanes[plan.inverse]
    axes = np.array(plan.map_Q), np.array(plan.map_dp)
    return inverse_table(lane.estimator, lane.state, *axes, state.T)


class Required(NamedTuple):
    """The answer to a standing demand: U and its 95 % interval, %, and the status."""

    U: float
    lower: float
    upper: float
    status: InverseStatus

    @property
    def width(self) -> float:
        """Width of the interval, %."""
        return self.upper - self.lower


NOTHING_REQUIRED = Required(np.nan, np.nan, np.nan, InverseStatus.NOT_FINITE)


def required(plan: ValvePlan, state: ValveState, advance: float = 0.0) -> Required:
    """Return U for the standing demand, approached so that hysteresis is passed through.

    ``advance`` (l/min) is added to the demanded flow, as far as the answers deliver up to there.
    """
    if np.isnan(state.demand_Q) or np.isnan(state.demand_dp):
        return NOTHING_REQUIRED
    answer = led(
        lambda Q: demanded(plan, state, Q, state.demand_dp, np.nan),
        state.demand_Q,
        advance,
        lambda found: found.status[0] in DELIVERS,
    )
    lane, U = state.lanes[plan.inverse], answer.U
    moving = answer.status[0] in DELIVERS and not lane.frozen
    if moving and isinstance(lane.estimator, PathDependent):
        U = lane.estimator.approached(lane.state, U)
    shift = float(U[0] - answer.U[0])
    lower, upper = float(answer.lower[0]) + shift, float(answer.upper[0]) + shift
    return Required(float(U[0]), lower, upper, InverseStatus(int(answer.status[0])))


def demanded(plan: ValvePlan, state: ValveState, Q: float, dp: float, T: float) -> Inversion:
    """Return U for one demand; if T is NaN, at the last measured temperature."""
    lane = state.lanes[plan.inverse]
    T = state.T if np.isnan(T) else T
    return invert(
        *(lane.estimator, lane.state, [Q], [dp], [T]),
        support=lane.support,
        accuracy=lane.accuracy,
        widened=None if lane.errors is None else lane.errors.widened,
    )


def predicted(lane: Lane, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats, Codes]:
    """Q, its standard deviation and the status at N points, all (N,).

    The standard deviation includes the sensors' systematic errors. The status is that of the
    estimator, or EXTRAPOLATING if no sample lies near.
    """
    Q, std, status = _as_measured(lane, U, dp, T)
    return Q, np.hypot(std, systematic(lane, U, dp, T)), status


def systematic(lane: Lane, U: Floats, dp: Floats, T: Floats) -> Floats:
    """Standard deviation of the flow due to sensor errors at N points, l/min (N,)."""
    if not lane.accuracy.is_stated:
        return np.zeros(len(U))

    def flow(*points: Floats) -> Floats:
        return lane.estimator.predict(lane.state, *points)[0]

    return systematic_std(lane.accuracy, flow, (U, dp, T), U_range_of(lane.estimator))


def _as_measured(lane: Lane, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats, Codes]:
    """As `predicted`, without the sensors' systematic errors."""
    Q, std = lane.estimator.predict(lane.state, U, dp, T)
    if lane.errors is not None:
        std = lane.errors.widened(std, U, dp, T)
    std, guessed = trusted(lane.estimator, lane.state, lane.support, (U, dp, T), Q, std)
    own = Status.WARMING_UP if lane.status is None else lane.status
    if own in (Status.WARMING_UP, Status.FAILED):  # these statuses take precedence
        guessed = np.zeros_like(guessed)
    return Q, std, np.where(guessed, np.uint8(Status.EXTRAPOLATING), np.uint8(own))


def predicted_measurement(
    lane: Lane, U: Floats, dp: Floats, T: Floats
) -> tuple[Floats, Floats, Codes]:
    """Q̂, half the 95 % interval of a new measurement, l/min, and status (N,); NaN if unknown.

    Assumes that the new measurement has the same systematic errors as the samples.
    """
    _, own = lane.estimator.predict(lane.state, U, dp, T)
    Q, std, status = _as_measured(lane, U, dp, T)
    with np.errstate(invalid="ignore"):
        beyond = np.where(status == Status.EXTRAPOLATING, np.maximum(std**2 - own**2, 0.0), 0.0)
        # the spread of the residuals includes the misfit, and a std that is taken from them
        known = 0.0 * own if isinstance(lane.estimator, ResidualStd) else own
        half = lane.spread.half_width(U, dp, np.sqrt(known**2 + beyond))
    if isinstance(lane.estimator, PathDependent):  # U may come from either side
        up, down = (
            lane.estimator.predict_along(lane.state, U, dp, T, np.full_like(U, side))[0]
            for side in (1.0, -1.0)
        )
        half = np.hypot(half, TWO_SIDED_95 * (up - down) / 2.0)
    return Q, half, status


def predicted_along(lane: Lane, samples: Samples) -> Floats:
    """Q̂ (N,) along a path of samples, without an update; hysteresis follows the path."""
    U, dp, T = samples.U, samples.dp, samples.T
    if isinstance(lane.estimator, PathDependent):
        directions = lane.estimator.directions(lane.state, U)
        Q, _ = lane.estimator.predict_along(lane.state, U, dp, T, directions)
    else:
        Q, _ = lane.estimator.predict(lane.state, U, dp, T)
    return Q


@dataclass(frozen=True)
class _Kept(State):
    """A lane as stored in a checkpoint."""

    state_version: ClassVar[int] = 3  # 2 stored residuals in double precision

    estimator: Any
    score: Any
    cells: Any
    stamps: Any
    ages: Any
    overall: Any
    seen: Any
    fit: Any
    ranges: Any
    count: Any

    @classmethod
    def of(cls, lane: Lane, packed: bytes) -> Self:
        """Build it from a lane, and its estimator's state as bytes."""
        spread, support = lane.spread, lane.support
        return cls(
            estimator=np.frombuffer(packed, np.uint8),
            score=lane.score.sums,
            cells=spread.cells,
            stamps=spread.stamps,
            ages=spread.ages,
            overall=spread.overall,
            seen=support.cells,
            fit=support.fit,
            ranges=support.ranges,
            count=np.array(lane.count),
        )

    def contents(self) -> Mapping[str, Contents]:
        """Return the permitted content."""
        score = Contents(self.score).within(0.0, where=_OF_SCORE)
        score.or_infinite([of_score.LOWEST_Q, of_score.HIGHEST_Q])
        overall = Contents(self.overall).within(0.0)
        multiples = slice(of_spread.QUANTILE, of_spread.TIMES)
        return {
            "score": score,
            "cells": Contents(self.cells).within(0.0),
            "ages": Contents(self.ages).within(0, of_spread.AGES),
            "overall": overall.within(0.0, WIDEST, multiples),
            "fit": Contents(self.fit).within(0.0, where=slice(lack_of_fit.SEEN, None)),
        }

    def is_coherent(self) -> bool:
        """Whether each range is non-empty."""
        U_low, U_high, dp_low, dp_high, Q_max = self.ranges.tolist()
        return bool(U_low < U_high and dp_low < dp_high and Q_max > 0.0)


def lane_to_bytes(lane: Lane, key: str) -> bytes:
    """Pack a lane; ``key`` is that of the configured estimator, without operators' settings."""
    return _Kept.of(lane, lane.state.to_bytes(key)).to_bytes(key)


def lane_from_bytes(
    data: bytes, configured: AnyEstimator, lam: float | None, *, frozen: bool, t: int
) -> Lane:
    """Unpack a lane.

    Raises
    ------
    StateMismatchError
        if the bytes belong to another estimator or other hyper-parameters, or their content is
        invalid.
    """
    key, kind, of_state, of_lane = _templates(cast("Hashable", configured))
    kept = _Kept.from_bytes(data, key)
    of_lane.check(kept)
    state = kind.from_bytes(kept.estimator.tobytes(), key)
    of_state.check(state)
    score = Score(kept.score)
    spread = ResidualSpread(kept.cells, kept.stamps, kept.ages, kept.overall)
    support = Support(kept.seen, kept.fit, kept.ranges)
    lane = Lane(configured, state, score, spread, support, frozen, count=int(kept.count), t=t)
    if lam is None:
        return lane
    if not isinstance(configured, Forgetful):
        raise StateMismatchError(f"a forgetting factor {lam!r}, and none is used")
    try:
        return with_forgetting(lane, lam)
    except ValueError as error:
        raise StateMismatchError(str(error)) from None


@lru_cache(maxsize=64)
def _templates(configured: Hashable) -> tuple[str, type[State], Template, Template]:
    """Return the estimator's hash, the type of its states, and templates to check them against."""
    estimator = cast("AnyEstimator", configured)
    key, fresh = key_of(estimator), fresh_lane(estimator)
    packed = _Kept.of(fresh, fresh.state.to_bytes(key))
    return key, type(fresh.state), Template(fresh.state), Template(packed)


def with_forgetting(lane: Lane, lam: float) -> Lane:
    """Return the lane with another forgetting factor; the estimator must be Forgetful."""
    assert isinstance(lane.estimator, Forgetful)  # noqa: S101 - callers check
    return replace(lane, estimator=lane.estimator.with_forgetting(lam), lam=lam)
