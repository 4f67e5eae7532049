"""One valve: its plan, its state, and functions of both. Pure."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np

from valvemap.model.capabilities import (
    FindsCauses,
    FitsInBursts,
    Forgetful,
)
from valvemap.model.estimator import Estimator, State
from valvemap.model.residual_spread import ResidualSpread
from valvemap.model.sensor_accuracy import EXACT, SensorAccuracy
from valvemap.model.support import Support
from valvemap.model.survey import Survey, survey
from valvemap.pipeline.alarm_rules import RULES, Alarm
from valvemap.pipeline.alarm_states import AlarmRule
from valvemap.pipeline.edges import Part
from valvemap.pipeline.feedforward import FeedForward
from valvemap.pipeline.map_errors import MapErrors
from valvemap.pipeline.meaning import Meaning
from valvemap.pipeline.nameplate import BLANK, Nameplate
from valvemap.pipeline.quality_gate import GateState, QualityGate
from valvemap.pipeline.score import Score
from valvemap.vocabulary.findings import Finding, FindingCode
from valvemap.vocabulary.statuses import Status

AnyEstimator = Estimator[Any]


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
    """Return the causes that an estimator finds in its samples; empty if it searches none."""
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


def with_forgetting(lane: Lane, lam: float) -> Lane:
    """Return the lane with another forgetting factor; the estimator must be Forgetful."""
    assert isinstance(lane.estimator, Forgetful)  # noqa: S101 - callers check
    return replace(lane, estimator=lane.estimator.with_forgetting(lam), lam=lam)
