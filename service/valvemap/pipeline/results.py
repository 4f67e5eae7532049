"""Results of the pipeline for the outside: descriptions, rows of arrays, alarms."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from valvemap.model.change import Change
from valvemap.model.samples import Codes, Floats, Times
from valvemap.model.survey import Survey
from valvemap.pipeline.alarm_results import AlarmResults
from valvemap.pipeline.dynamics_results import DynamicsResults
from valvemap.pipeline.nameplate import BLANK, Nameplate
from valvemap.pipeline.recommendation import Recommendation
from valvemap.vocabulary.feed_forward import FeedForwardStatus
from valvemap.vocabulary.findings import Finding
from valvemap.vocabulary.quantities import ESTIMATOR_QUANTITIES
from valvemap.vocabulary.statuses import Adaptation, Quality, Status


@dataclass(frozen=True)
class EstimatorDescription:
    """The properties of an estimator that a results server publishes."""

    name: str
    description: str
    parameter_names: tuple[str, ...]
    has_forgetting_factor: bool
    finds_changes: bool = False
    chooses_structure: bool = False
    finds_lags: bool = False
    has_named_parameters: bool = False  # few parameters, each with a physical meaning


@dataclass(frozen=True)
class ValveDescription:
    """The properties of a valve that a results server publishes; ranges are (low, high)."""

    name: str
    estimators: tuple[EstimatorDescription, ...]
    Q_range: tuple[float, float] = (0.0, 200.0)
    dp_range: tuple[float, float] = (0.0, 200.0)
    map_Q: tuple[float, ...] = ()
    map_dp: tuple[float, ...] = ()
    counters: tuple[str, ...] = ()
    nameplate: Nameplate = BLANK
    U_range: tuple[float, float] = (0.0, 100.0)
    is_line: bool = False
    is_driven: bool = False


@dataclass(frozen=True)
class EstimatorResult:
    """Result of one estimator after one sample.

    ``t`` is the source time (UTC ns) of the sample. ``quality`` becomes the OPC UA severity:
    UNCERTAIN while the parameters are not determined or excitation is poor, BAD when the sensors
    are lost. ``survey`` is computed with the inverse map; None before the first. ``change`` is the
    last detected change of the valve, ``structure`` the chosen model structure. ``lags`` are the
    lags of U's effect and of the flow meter, s. ``systematic_std`` is the flow's standard deviation
    due to sensor errors at the newest sample, l/min; NaN if they are not configured.
    ``adaptation`` is the estimator's diagnosis of its residuals.
    """

    t: int
    quality: Quality
    theta: Floats
    std: Floats
    predicted: float
    residual: float
    residual_rmse: float
    sample_count: int
    status: Status
    noise_std: float = np.nan
    survey: Survey | None = None
    change: Change | None = None
    structure: str | None = None
    lags: tuple[float, float] | None = None
    adaptation: Adaptation = Adaptation.UNDECIDED
    systematic_std: float = np.nan


@dataclass(frozen=True)
class InverseResult:
    """Answer to the standing demand (FlowDemand, PressureDrop), and the map as a table.

    ``required_U`` is between ``lower`` and ``upper`` with 95 % probability, all in %. ``map_U`` has
    shape (len(map_Q), len(map_dp)), %; NaN where the valve cannot deliver. ``armed``
    and ``feed_forward`` give the state of feed-forward: whether the answer is written to the valve.
    """

    t: int
    quality: Quality
    required_U: float
    status: int
    map_U: Floats
    armed: bool = False
    feed_forward: FeedForwardStatus = FeedForwardStatus.NOT_CONFIGURED
    lower: float = np.nan
    upper: float = np.nan


@dataclass(frozen=True)
class ValveResult:
    """All results of one valve."""

    valve: int
    estimators: Mapping[str, EstimatorResult]
    inverse: InverseResult
    counters: Mapping[str, int]


@dataclass(frozen=True)
class EstimatorResults:
    """One estimator on M valves: the fields of :class:`EstimatorResult`, all of length M.

    ``theta`` and ``std`` have shape (M, n). ``old`` masks the valves whose newest sample is old;
    None: no valve.
    """

    t: Times
    quality: Codes
    theta: Floats
    std: Floats
    predicted: Floats
    residual: Floats
    residual_rmse: Floats
    sample_count: Times
    status: Codes
    noise_std: Floats
    survey: Sequence[Survey | None]
    change: Sequence[Change | None]
    structure: Sequence[str | None]
    lags: Sequence[tuple[float, float] | None]
    adaptation: Codes
    systematic_std: Floats
    old: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class InverseResults:
    """The inverse maps of M valves: the fields of :class:`InverseResult`, all of length M."""

    t: Times
    quality: Codes
    required_U: Floats
    status: Codes
    map_U: Sequence[Floats]
    armed: NDArray[np.bool_]
    feed_forward: Codes
    lower: Floats
    upper: Floats


@dataclass(frozen=True)
class LineResults:
    """What M lines of valves with ports have beside other valves; all arrays (M,).

    ``leakage`` and ``leakage_std`` are in l/min/bar, NaN while unknown. ``edge`` (`LineEdge`)
    passes the demanded flow.
    """

    leakage: Floats
    leakage_std: Floats
    edge: Codes


@dataclass(frozen=True)
class SignalResults:
    """The newest sample of each of M valves as received, in the service's units.

    ``values`` has a column for each of ``vocabulary.signals.PUBLISHED``; NaN if absent. ``quality``
    (M,) is the source's, BAD if the sensors are lost; ``t`` (M,) is 0 before the first sample.
    """

    t: Times
    quality: Codes
    values: Floats


class Version(Protocol):
    """An approved map: its name, source time of its newest sample (UTC ns), its hash."""

    @property
    def version(self) -> str:
        """Its name."""

    @property
    def t(self) -> int:
        """UTC ns."""

    @property
    def digest(self) -> str:
        """SHA-256, hexadecimal."""


class Compared(Protocol):
    """A map minus the approved one, l/min."""

    @property
    def mean(self) -> float:
        """Mean difference over all points."""

    @property
    def largest(self) -> float:
        """Largest difference by magnitude, signed."""

    @property
    def U(self) -> float:
        """U of the largest difference, %."""

    @property
    def dp(self) -> float:
        """Pressure drop of the largest difference, bar."""

    @property
    def points(self) -> int:
        """Number of compared points."""


@dataclass(frozen=True)
class Results:
    """All published results of M valves with the same plan.

    ``valves`` (M,) are their numbers; ``counters`` have a column for each of ``counter_names``.
    For each valve, ``waiting`` gives the reasons why its samples are not used, ``timing`` how its
    signals are stamped, ``baselines`` its approved map, ``recommended`` the estimator to use,
    ``findings`` the causes that explain its samples, ``dynamics`` those of spool and meter,
    ``alarms`` the state of its alarms.
    """

    valves: Times
    estimators: Mapping[str, EstimatorResults]
    inverse: InverseResults
    counters: Times
    counter_names: tuple[str, ...]
    signals: SignalResults | None = None
    waiting: Sequence[tuple[str, ...]] = ()
    timing: Sequence[tuple[str, ...]] = ()
    baselines: Sequence[Version | None] = ()
    recommended: Sequence[Recommendation] = ()
    findings: Sequence[tuple[Finding, ...]] = ()
    dynamics: Sequence[DynamicsResults] = ()
    alarms: AlarmResults | None = None
    lines: LineResults | None = None

    def one(self, m: int) -> ValveResult:
        """Return the results of the m-th valve."""
        return ValveResult(
            valve=int(self.valves[m]),
            estimators={
                name: EstimatorResult(
                    t=int(found.t[m]),
                    quality=Quality(int(found.quality[m])),
                    theta=found.theta[m],
                    std=found.std[m],
                    survey=found.survey[m],
                    change=found.change[m],
                    structure=found.structure[m],
                    lags=found.lags[m],
                    **{
                        quantity.field: quantity.one(getattr(found, quantity.field)[m])
                        for quantity in ESTIMATOR_QUANTITIES
                    },
                )
                for name, found in self.estimators.items()
            },
            inverse=InverseResult(
                t=int(self.inverse.t[m]),
                quality=Quality(int(self.inverse.quality[m])),
                required_U=float(self.inverse.required_U[m]),
                status=int(self.inverse.status[m]),
                map_U=self.inverse.map_U[m],
                armed=bool(self.inverse.armed[m]),
                feed_forward=FeedForwardStatus(int(self.inverse.feed_forward[m])),
                lower=float(self.inverse.lower[m]),
                upper=float(self.inverse.upper[m]),
            ),
            counters=dict(zip(self.counter_names, self.counters[m].tolist(), strict=True)),
        )
