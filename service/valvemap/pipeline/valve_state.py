"""One valve: what is done with it, how it stands, and what follows from that. Pure."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple, Protocol, Self, cast, runtime_checkable

import numpy as np

from valvemap.model.change import FindsChanges
from valvemap.model.contents import Contents
from valvemap.model.estimator import Estimator, State, StateMismatchError, Template, key_of
from valvemap.model.extrapolation import U_range_of, trusted
from valvemap.model.forgetting import Adaptive
from valvemap.model.inverse_map import inverse_table, invert
from valvemap.model.inversion import Inversion
from valvemap.model.kernels import lack_of_fit
from valvemap.model.kernels import residual_spread as of_spread
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.residual_spread import TWO_SIDED_95, ResidualSpread
from valvemap.model.samples import Codes, Floats, Samples
from valvemap.model.sensor_accuracy import EXACT, SensorAccuracy, systematic_std
from valvemap.model.support import Support
from valvemap.model.survey import Survey, survey
from valvemap.pipeline.alarm_states import AlarmRule
from valvemap.pipeline.alarms import RULES, Alarm
from valvemap.pipeline.feedforward import FeedForward
from valvemap.pipeline.kernels import score as of_score
from valvemap.pipeline.nameplate import BLANK, Nameplate
from valvemap.pipeline.quality_gate import GateState, QualityGate
from valvemap.pipeline.score import Score
from valvemap.vocabulary.statuses import InverseStatus, Status

AnyEstimator = Estimator[Any]

WIDEST = 1e9  # times its root mean square that an interval can be: what is off moves both

_OF_SCORE = [  # never negative
    *(of_score.N, of_score.SQUARES, of_score.SCATTER_Q),
    *(of_score.RECENT, of_score.WEIGHT, of_score.LARGEST),
]


@runtime_checkable
class Forgetful(Protocol):
    """An estimator with a forgetting factor."""

    @property
    def lam(self) -> float:
        """The forgetting factor, 0 < lam <= 1."""

    def with_forgetting(self, lam: float) -> Self:
        """The same estimator with another forgetting factor; its states fit."""


@runtime_checkable
class PathDependent(Protocol):
    """An estimator whose flow depends on where U comes from (hysteresis)."""

    def directions(self, state: Any, U: Floats) -> Floats:  # noqa: ANN401 - its own state
        """Direction of U (N,) along a path of its own."""

    def predict_along(
        self,
        state: Any,  # noqa: ANN401
        U: Floats,
        dp: Floats,
        T: Floats,
        direction: Floats,
    ) -> tuple[Floats, Floats]:
        """Flow and standard deviation, l/min, at N points of given directions."""

    def approached(self, state: Any, U: Floats) -> Floats:  # noqa: ANN401
        """U (N,) that brings the valve from where it is to where U holds it."""


@dataclass(frozen=True)
class ValvePlan:
    """What is done with one valve's samples.

    ``inverse`` names the estimator whose map is inverted; ``map_Q`` (l/min) and ``map_dp`` (bar)
    are the axes of the published table; ``feed_forward`` says how its answer may be written to the
    valve, if at all; with ``insist`` it is learnt from data that cannot be what they are called;
    ``accuracy`` is that of its sensors, ``nodes`` says what to call them where one is missing,
    ``alarms`` when each comes and goes; ``nameplate`` is for those who look.
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


@dataclass(frozen=True)
class Lane:
    """One estimator on one valve, with its state and what the operator changed."""

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


@dataclass(frozen=True)
class ValveState:
    """All that one valve's pipeline remembers."""

    gate: GateState
    lanes: Mapping[str, Lane]
    t: int = 0
    T: float = np.nan
    demand_Q: float = np.nan
    demand_dp: float = np.nan


def fresh_lane(estimator: AnyEstimator, support: Support | None = None) -> Lane:
    """An estimator that has seen nothing; ``support`` is as empty, and knows the valve's ranges."""
    return Lane(
        estimator, estimator.initial_state(), Score.none(), support=support or Support.none()
    )


def nothing_seen(plan: ValvePlan) -> Support:
    """What an estimator's map rests on before the first sample."""
    return Support.none(plan.U_range, (min(0.0, *plan.map_dp), max(plan.map_dp)), max(plan.map_Q))


def finds_changes(estimator: AnyEstimator) -> bool:
    """Whether an estimator looks for abrupt changes of the valve and tells of them."""
    if isinstance(estimator, RecursiveLeastSquares):
        return isinstance(estimator.forgetting, Adaptive)
    return isinstance(estimator, FindsChanges)


def survey_of(plan: ValvePlan, state: ValveState, name: str) -> Survey:
    """What an estimator's map knows and does not know, at the last temperature."""
    lane = state.lanes[name]
    dp_max, Q_max = max(plan.map_dp), max(plan.map_Q)
    return survey(
        lane.estimator, lane.state, lane.spread, state.t, state.T, dp_max=dp_max, Q_max=Q_max
    )


def inverse_map(plan: ValvePlan, state: ValveState) -> Floats:
    """The inverse as a table (len(map_Q), len(map_dp)), %, at the last temperature."""
    lane = state.lanes[plan.inverse]
    axes = np.array(plan.map_Q), np.array(plan.map_dp)
    return inverse_table(lane.estimator, lane.state, *axes, state.T)


class Required(NamedTuple):
    """The answer to a standing demand: U and the width of its 95 % interval, %, and the status."""

    U: float
    width: float
    status: InverseStatus


NOTHING_REQUIRED = Required(np.nan, np.nan, InverseStatus.NOT_FINITE)


def required(plan: ValvePlan, state: ValveState) -> Required:
    """U for the standing demand, hysteresis passed through."""
    if np.isnan(state.demand_Q) or np.isnan(state.demand_dp):
        return NOTHING_REQUIRED
    answer = demanded(plan, state, state.demand_Q, state.demand_dp, np.nan)
    lane, U = state.lanes[plan.inverse], answer.U
    moving = answer.status[0] == InverseStatus.OK and not lane.frozen
    if moving and isinstance(lane.estimator, PathDependent):
        U = lane.estimator.approached(lane.state, U)
    width = float(answer.upper[0] - answer.lower[0])
    return Required(float(U[0]), width, InverseStatus(int(answer.status[0])))


def demanded(plan: ValvePlan, state: ValveState, Q: float, dp: float, T: float) -> Inversion:
    """U for one demand; where T is NaN the last measured temperature serves."""
    lane = state.lanes[plan.inverse]
    T = state.T if np.isnan(T) else T
    return invert(
        *(lane.estimator, lane.state, [Q], [dp], [T]), support=lane.support, accuracy=lane.accuracy
    )


def predicted(lane: Lane, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats, Codes]:
    """Q and its standard deviation at N points, and how far they can be trusted, all (N,).

    What the sensors may be off by is in the standard deviation. The status is that of the
    estimator, or EXTRAPOLATING where nothing was measured near.
    """
    Q, std, status = _as_measured(lane, U, dp, T)
    return Q, np.hypot(std, systematic(lane, U, dp, T)), status


def systematic(lane: Lane, U: Floats, dp: Floats, T: Floats) -> Floats:
    """What the sensors' errors make of the flow at N points, one standard deviation, l/min (N,)."""
    if not lane.accuracy.is_stated:
        return np.zeros(len(U))

    def flow(*points: Floats) -> Floats:
        return lane.estimator.predict(lane.state, *points)[0]

    return systematic_std(lane.accuracy, flow, (U, dp, T), U_range_of(lane.estimator))


def _as_measured(lane: Lane, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats, Codes]:
    """The same, as the sensors would show it."""
    Q, std = lane.estimator.predict(lane.state, U, dp, T)
    std, guessed = trusted(lane.estimator, lane.state, lane.support, (U, dp, T), Q, std)
    own = Status.WARMING_UP if lane.status is None else lane.status
    if own in (Status.WARMING_UP, Status.FAILED):  # less than a guess
        guessed = np.zeros_like(guessed)
    return Q, std, np.where(guessed, np.uint8(Status.EXTRAPOLATING), np.uint8(own))


def predicted_measurement(
    lane: Lane, U: Floats, dp: Floats, T: Floats
) -> tuple[Floats, Floats, Codes]:
    """Q̂, half the 95 % interval of a new measurement, l/min, and status (N,); NaN if unknown.

    The sensors that will measure it are off as they were before.
    """
    _, own = lane.estimator.predict(lane.state, U, dp, T)
    Q, std, status = _as_measured(lane, U, dp, T)
    with np.errstate(invalid="ignore"):
        beyond = np.where(status == Status.EXTRAPOLATING, np.maximum(std**2 - own**2, 0.0), 0.0)
        # the spread of the residuals holds the misfit already, and the network's own std, too
        known = 0.0 * own if isinstance(lane.estimator, RbfNetwork) else own
        half = lane.spread.half_width(U, dp, np.sqrt(known**2 + beyond))
    if isinstance(lane.estimator, PathDependent):  # U may come from either side
        up, down = (
            lane.estimator.predict_along(lane.state, U, dp, T, np.full_like(U, side))[0]
            for side in (1.0, -1.0)
        )
        half = np.hypot(half, TWO_SIDED_95 * (up - down) / 2.0)
    return Q, half, status


def predicted_along(lane: Lane, samples: Samples) -> Floats:
    """Q̂ (N,) along a path of samples that nothing is learnt from; hysteresis follows the path."""
    U, dp, T = samples.U, samples.dp, samples.T
    if isinstance(lane.estimator, PathDependent):
        directions = lane.estimator.directions(lane.state, U)
        Q, _ = lane.estimator.predict_along(lane.state, U, dp, T, directions)
    else:
        Q, _ = lane.estimator.predict(lane.state, U, dp, T)
    return Q


@dataclass(frozen=True)
class _Kept(State):
    """A lane as it goes into a checkpoint."""

    state_version: ClassVar[int] = 3  # 2: kept its residuals in double precision

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
        """A lane, and its estimator's state as bytes."""
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
        """What may stand in them."""
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
        """Whether the ranges are some."""
        U_low, U_high, dp_low, dp_high, Q_max = self.ranges.tolist()
        return bool(U_low < U_high and dp_low < dp_high and Q_max > 0.0)


def lane_to_bytes(lane: Lane, key: str) -> bytes:
    """Pack a lane; ``key`` is that of the estimator as configured, whatever operators changed."""
    return _Kept.of(lane, lane.state.to_bytes(key)).to_bytes(key)


def lane_from_bytes(
    data: bytes, configured: AnyEstimator, lam: float | None, *, frozen: bool, t: int
) -> Lane:
    """Unpack a lane.

    Raises
    ------
    StateMismatchError
        if the bytes belong to another estimator or other hyper-parameters, or hold what cannot
        have been learnt.
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
    """Hash of an estimator, type of its states, and by what they and its lanes are judged."""
    estimator = cast("AnyEstimator", configured)
    key, fresh = key_of(estimator), fresh_lane(estimator)
    packed = _Kept.of(fresh, fresh.state.to_bytes(key))
    return key, type(fresh.state), Template(fresh.state), Template(packed)


def with_forgetting(lane: Lane, lam: float) -> Lane:
    """The lane with another forgetting factor; the estimator must be Forgetful."""
    assert isinstance(lane.estimator, Forgetful)  # noqa: S101 - callers check
    return replace(lane, estimator=lane.estimator.with_forgetting(lam), lam=lam)
