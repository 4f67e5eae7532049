"""A cylinder as the flow meter: four edges, bulk modulus and leakage from position and pressures.

For line A of a 4/3 valve on a cylinder (B likewise), with V_A(x) = V_0A + A_A·x::

    A_A·ẋ + (V_A/β)·ṗ_A = Q_PA(U, p_S - p_A) - Q_AT(U, p_A - p_T) - c·(p_A - p_B)

It is linear in the edges' maps, in 1/β and in c at 40 °C; at another temperature c is in inverse
proportion to the viscosity of an oil of ISO VG 46. An edge's map is K(y)·√Δp with K a quadratic
spline of the spool's position y, and a departure from √Δp proportional to y. The spool's position
comes from U through play and a lag of 2nd order, which are found by the residual
(:mod:`~valvemap.model.axis_search`). Smoothness is a Gaussian prior on the slope of K; its size is
the one of highest evidence.

A wrong piston area cannot be seen in these signals: it scales all flows by one factor, and the
speeds that the maps predict stay right.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from valvemap.model.axis_basis import KNOTS, PLACES, SIZE, SPLINE, WALTHER
from valvemap.model.kernels import axis_drift, flow_drift, flow_rules
from valvemap.model.kernels import axis_rows as kernel
from valvemap.model.samples import Codes, Flags, Floats, Times, column
from valvemap.vocabulary.edges import EDGES

SPOOL_DAMPING: Final = 0.8  # of the assumed spool; its frequency is found
_SIGNALS: Final = ("U", "x", "pA", "pB", "pS", "pT")
_OTHERS: Final = ("T", "v")
_SETTLING_S: Final = 0.1  # s; after a gap, until the spool's course is known again
_BLOCK_S: Final = 1.0  # s; of the block sums that tell how far residuals hang together
_FADED: Final = 6.0  # times the filter's; an impulse then has 4 % of its largest effect
_ROW_S: Final = 0.04  # s; from row to row: a fraction of the filter's time
_LONGEST: Final = 2.5  # sampling periods; a longer interval is a gap


@dataclass(frozen=True)
class AxisGeometry:
    """Piston and rod diameter, stroke (mm), and each line's volume at its shortest (l).

    Examples
    --------
    >>> geometry = AxisGeometry(63, 45, 800, 1.2, 1.2)
    >>> round(geometry.A_A, 2), round(geometry.A_B, 2)
    (31.17, 15.27)
    """

    piston_mm: float
    rod_mm: float
    stroke_mm: float
    dead_A_l: float
    dead_B_l: float

    @property
    def A_A(self) -> float:
        """Area of the piston, cm²."""
        return math.pi / 400.0 * self.piston_mm**2

    @property
    def A_B(self) -> float:
        """Annular area, cm²."""
        return math.pi / 400.0 * (self.piston_mm**2 - self.rod_mm**2)


@dataclass(frozen=True)
class AxisSamples:
    """N samples of an axis: t (UTC ns), U (%), x (mm), pA, pB, pS, pT (bar), T (°C), v (mm/s).

    All are (N,). x = 0 where line A is shortest; U > 0 moves towards larger x. NaN is a missing
    value. Where v is measured, x serves the volumes alone (:mod:`~valvemap.model.axis_travel`).
    """

    t: Times
    U: Floats
    x: Floats
    pA: Floats
    pB: Floats
    pS: Floats
    pT: Floats
    T: Floats
    v: Floats

    @classmethod
    def of(cls, t: ArrayLike, **signals: ArrayLike | None) -> "AxisSamples":
        """Convert anything array-like; a signal that is not given is NaN."""
        time = column(t, np.int64)
        given = {
            name: np.full(time.shape, np.nan)
            if (values := signals.get(name)) is None
            else column(values, np.float64)
            for name in (*_SIGNALS, *_OTHERS)
        }
        return cls(time, **given)

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, rows: slice | Flags) -> "AxisSamples":
        names = (*_SIGNALS, *_OTHERS)
        return AxisSamples(self.t[rows], *(getattr(self, name)[rows] for name in names))


@dataclass(frozen=True)
class AxisState:
    """State of the regression; arrays as in :func:`.kernels.axis_rows.axis_rows`."""

    last: Times
    memory: Floats
    filtered: Floats
    M: Floats
    b: Floats
    squares: Floats
    counts: Times
    theta: Floats
    errors: Floats
    score: Floats
    scores: Floats
    drift_x: Floats
    drift_P: Floats
    drift_chance: Floats
    drift_now: Floats
    stay: Floats
    stay_end: Times
    stay_noise: Floats
    known: Floats

    @property
    def moving(self) -> axis_drift.Moving:
        """What moves at the edges, as the kernels have it."""
        return axis_drift.Moving(
            self.drift_x,
            self.drift_P,
            self.drift_chance,
            self.drift_now,
            self.stay,
            self.stay_end,
            self.stay_noise,
            self.known,
        )

    @property
    def has_changed(self) -> bool:
        """Whether an edge has changed suddenly, for certain, and not long ago."""
        chance = self.drift_chance
        jumped = chance[:, flow_drift.OTHER_GAIN : flow_drift.NAMED].sum(axis=-1)
        moved = np.maximum(jumped, chance[:, flow_drift.WANDERING])
        return bool((moved > flow_rules.CERTAIN).any())

    @property
    def rows(self) -> int:
        """Number of intervals that were used."""
        return int(self.counts[0])

    def reasons(self) -> dict[str, int]:
        """Return the number of intervals that were left out, by reason."""
        names = ("used", "gap", "missing", "low pressure", "end stop")
        return dict(zip(names, self.counts[1:].tolist(), strict=True))


class AxisTrace(NamedTuple):
    """Per sample: why it was left out (``kernels.axis_rows``), residuals of both lines, l/min.

    ``speed`` (N, 2) is the piston's, mm/s: as measured, and by the map of the state.
    """

    reason: Codes
    residual: Floats
    speed: Floats


@dataclass(frozen=True)
class AxisRegression:
    """Recursive regression of an axis, given play and spool; forgetting in s of use, inf = none.

    Attributes
    ----------
    geometry : AxisGeometry
    period_s
        Sampling period.
    play_percent, spool_hz
        Width of the loop of U, and the spool's natural frequency; inf = no lag.
    filter_hz
        Corner of the low-pass of 2nd order.
    memory_s
        Time constant of forgetting, s of used intervals.
    lowest_bar, margin_mm
        Below this pressure, and this near to an end stop, intervals are left out.
    changes_per_s
        Sudden changes expected of an edge, 1/s of use; 0: gain and edge stay (``axis_drift``).
    has_place
        Whether the position is measured; else it is a range, and the volumes are less certain.
    """

    geometry: AxisGeometry
    period_s: float = 0.01
    play_percent: float = 0.0
    spool_hz: float = math.inf
    filter_hz: float = 3.0
    memory_s: float = math.inf
    lowest_bar: float = 3.0
    margin_mm: float = 2.0
    changes_per_s: float = 0.0
    has_place: bool = True

    def initial_state(self) -> AxisState:
        """Return the state before the first sample."""
        n = len(EDGES)
        drift = (n, flow_drift.MODELS, flow_drift.STATES)
        x, P = np.zeros(drift), np.zeros((n, flow_drift.PACKED))
        chance = np.zeros(drift[:2])
        now = np.zeros((n, 1 + flow_drift.SHOWN, flow_drift.SHOWN))
        for k in range(0, n, 2):
            pair = slice(k, k + 2)
            flow_drift.begin(x[pair], P[pair], chance[pair], now[pair])
        return AxisState(
            last=np.zeros(1, np.int64),
            memory=np.zeros(len(kernel.MEMORY)),
            filtered=np.zeros((2, 2, SIZE + 3)),
            M=np.zeros((SIZE, SIZE)),
            b=np.zeros(SIZE),
            squares=np.zeros(3),
            counts=np.zeros(6, np.int64),
            theta=np.zeros(SIZE),
            errors=np.zeros((2, 5)),
            score=np.zeros(SIZE),
            scores=np.zeros((SIZE, SIZE)),
            drift_x=x,
            drift_P=P,
            drift_chance=chance,
            drift_now=now,
            stay=np.zeros((n, axis_drift.MEAN + KNOTS)),
            stay_end=np.zeros(n, np.int64),
            stay_noise=np.zeros((2, 2)),
            known=np.zeros((n, KNOTS, KNOTS)),
        )

    def update(
        self, state: AxisState, samples: AxisSamples, left_out: Flags | None = None
    ) -> tuple[AxisState, AxisTrace]:
        """Return the state after the samples; any division of them gives the same bits.

        ``left_out`` (N,) are intervals, each by the sample at its end, that are not to be used.
        """
        after = AxisState(**{name: array.copy() for name, array in vars(state).items()})
        n = len(samples)
        status, residual, speed = np.empty(n, np.uint8), np.empty((n, 2)), np.empty((n, 2))
        kernel.axis_rows(
            samples.t,
            np.ascontiguousarray(
                np.stack([getattr(samples, s) for s in (*_SIGNALS, *_OTHERS)], axis=1)
            ),
            np.zeros(n, np.bool_) if left_out is None else left_out,
            after.last,
            after.memory,
            after.filtered,
            after.M,
            after.b,
            after.squares,
            after.counts,
            after.theta,
            after.errors,
            after.score,
            after.scores,
            after.moving,
            SPLINE.table,
            SPLINE.breaks,
            self._geometry_numbers,
            self._settings,
            PLACES,
            status,
            residual,
            speed,
        )
        return after, AxisTrace(status, residual, speed)

    @property
    def row_s(self) -> float:
        """Time from row to row, s."""
        return max(1.0, round(_ROW_S / self.period_s)) * self.period_s

    @cached_property
    def _geometry_numbers(self) -> Floats:
        g = self.geometry
        return np.array([g.A_A, g.A_B, g.stroke_mm, g.dead_A_l, g.dead_B_l])

    @cached_property
    def _settings(self) -> Floats:
        share = -math.expm1(-2.0 * math.pi * self.filter_hz * self.period_s)
        forget = math.exp(-self.period_s / self.memory_s)
        stride = round(self.row_s / self.period_s)
        spool = spool_transition(self.spool_hz, self.period_s / kernel.PARTS)
        return np.array(
            [
                self.period_s,
                0.5 * self.play_percent,
                *spool,
                0.0,
                0.0,
                share,
                forget,
                self.lowest_bar,
                self.margin_mm,
                _LONGEST * self.period_s,
                max(1.0, round(_SETTLING_S / self.period_s)),
                max(1.0, round(_BLOCK_S / (stride * self.period_s))),
                stride,
                max(1.0, round(_FADED / (2.0 * math.pi * self.filter_hz * self.period_s))),
                *WALTHER,
                self.changes_per_s,
            ]
        )


def spool_transition(hz: float, step_s: float) -> tuple[float, float, float, float]:
    """Return the transition of a spool's deviation and speed over a step, row by row.

    >>> spool_transition(math.inf, 0.01)
    (0.0, 0.0, 0.0, 0.0)
    """
    if math.isinf(hz):
        return 0.0, 0.0, 0.0, 0.0
    omega = 2.0 * math.pi * hz
    decay, swing = SPOOL_DAMPING * omega, omega * math.sqrt(1.0 - SPOOL_DAMPING**2)
    e, c, s = math.exp(-decay * step_s), math.cos(swing * step_s), math.sin(swing * step_s)
    return (
        e * (c + decay / swing * s),
        e * s / swing,
        -e * omega * omega / swing * s,
        e * (c - decay / swing * s),
    )
