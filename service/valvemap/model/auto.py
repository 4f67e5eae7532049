"""`Auto`: the structure of the map chosen online, by prequential error and BIC."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import ClassVar, Final, Self

import numpy as np
from numpy.typing import NDArray

from valvemap.model import auto_lags
from valvemap.model.auto_anew import Rule
from valvemap.model.auto_fits import refit
from valvemap.model.auto_map import AutoMap
from valvemap.model.auto_state import (
    CHAMPION,
    AutoState,
    Counts,
    empty,
    shape_of,
    surface_of,
)
from valvemap.model.change import Change
from valvemap.model.fleet import alone, member, update_one
from valvemap.model.forgetting import check_lam, lam_of_memory
from valvemap.model.kernels import cells as memory
from valvemap.model.kernels import ladder, lag
from valvemap.model.kernels import surface as kernel
from valvemap.model.kernels.surface import Surface
from valvemap.model.map_shapes import Shape
from valvemap.model.model_structures import FiveTerms, Structure
from valvemap.model.samples import Codes, Floats, Samples, Segments, Times, Trace
from valvemap.vocabulary.statuses import Adaptation, Quality

UNKNOWN: Final = 1e4  # variance over σ² of a map that says nothing
LEAST_LAM: Final = lam_of_memory(2)  # of a cell's samples: its mean and the noise come from them
SITES: Final = tuple(product(range(0, 101, 10), (5, 20, 50, 100, 150)))


@dataclass(frozen=True)
class Auto:
    """Chooses the structure of the map online, and with it identifies the map.

    A grid of cells over (U, √dp), split by temperature and direction of U, remembers the mean of
    the samples that fell into each. To these means, weighted by their numbers, any structure is
    fitted by least squares, eq. (16), when new cells and the budget
    (:mod:`~valvemap.model.fit_budget`) call for it. The ladder
    (:class:`~valvemap.model.map_shapes.Shape`) leads from eq. (7) to cubic tensor splines
    of many cells, with a dead band, a saturation, hysteresis (U lags by half its width) and a trend
    with temperature.

    U's effect may lag behind U, and the meter behind the flow, both of first order. The lags are
    those that leave least unexplained in the last samples (:mod:`~valvemap.model
    .lag_search`), looked for now and then, or given. A sample is then learnt at where U and s lag
    to, and what the meter's lag makes of the map beyond that is taken off.

    Two shapes run at once. The *challenger* climbs, a few steps of the ladder at each fit, to a
    smaller::

        BIC = (Σ w·e² + penalty) / σ² + n_effective · ln(cells)

    where σ² is what the richest spline leaves. It becomes *champion*, whose map is published, when
    it has predicted the samples since the last fit no worse (2 %) than the champion, one step
    ahead. BIC proposes, the prequential error disposes.

    Forgetting is local: a cell remembers its last 1/(1 - lam) samples, and one that is not visited
    keeps what it knows. A change of the valve is a CUSUM on the residual against the sample's own
    cell, which no misfit can raise; it opens the memory, and what was learnt stays as a faint
    prior.

    Its parameters are the map itself: Q at 55 points, 40 °C, direction 0, whatever the shape.

    Parameters
    ----------
    lam
        Forgetting factor of a cell, per sample that falls into it; LEAST_LAM <= lam <= 1.
    steps
        Steps of the ladder tried at each fit, at most.
    lag_U, lag_Q
        First-order lag of U's effect and of the flow meter, s; None: looked for.

    Examples
    --------
    >>> from valvemap.model.samples import Samples
    >>> U, dp = np.meshgrid(np.linspace(0, 100, 40), np.linspace(1, 200, 40))
    >>> Q = 0.14 * U.ravel() * np.sqrt(dp.ravel())
    >>> auto = Auto()
    >>> state, _ = auto.update(
    ...     auto.initial_state(), Samples.of(np.arange(1600), U.ravel(), dp.ravel(), 0 * Q, Q)
    ... )
    >>> auto.describe(state)
    'eq. (7)'
    >>> auto.predict(state, np.array([50.0]), np.array([100.0]), np.array([40.0]))[0].round(3)
    array([70.])
    """

    fits_in_bursts: ClassVar[bool] = True  # most updates are quick, some fit maps

    lam: float = 0.998
    steps: int = 16
    lag_U: float | None = None
    lag_Q: float | None = None

    def __post_init__(self) -> None:
        for name in ("lag_U", "lag_Q"):
            tau = getattr(self, name)
            if tau is not None and not 0.0 <= tau < math.inf:
                raise ValueError(f"{name} = {tau!r} s is not a time")
        check_lam(self.lam, LEAST_LAM)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the points at which the map is published."""
        return tuple(f"Q({U}%,{dp}bar)" for U, dp in SITES)

    def with_forgetting(self, lam: float) -> Self:
        """Use another forgetting factor; states may be carried over."""
        return replace(self, lam=lam)

    def initial_state(self) -> AutoState:
        """State before the first sample."""
        return empty(self.lag_U, self.lag_Q)

    def update(self, state: AutoState, samples: Samples) -> tuple[AutoState, Trace]:
        """Take N samples in, one after another."""
        return update_one(self, state, samples)

    def update_many(self, states: AutoState, samples: Samples, segments: Segments) -> Trace:
        """Take the samples of many valves in; their states are written in place."""
        N = len(samples)
        predicted, residual = np.full((2, N), np.nan)
        trace = Trace(predicted, residual, residual, np.zeros(N, np.uint8))
        batch = memory.Batch(
            t=samples.t,
            U=samples.U,
            dp=samples.dp,
            T=samples.T,
            Q=samples.Q,
            usable=samples.quality != Quality.BAD,
            predicted=predicted,
            residual=residual,
            status=trace.status,
        )
        fleet = memory.Fleet(*(getattr(states, name) for name in memory.Fleet._fields))
        longest = math.inf if self.lam == 1.0 else 1.0 / (1.0 - self.lam)
        rule = Rule((self.lag_U, self.lag_Q), longest, self.steps)
        scratch = np.empty((4, 4))
        segment, row = 0, int(segments.starts[0]) if len(segments.starts) else 0
        with np.errstate(all="ignore"):
            while segment < len(segments.members):
                segment, row = memory.run_many(
                    segment, row, batch, *segments, longest, fleet, scratch
                )
                if segment < len(segments.members):
                    state = member(states, int(segments.members[segment]))
                    auto_lags.attend(state, rule, float(samples.T[row - 1]))
                    if memory.is_due(state.counters):
                        refit(state, self.steps)
        return trace

    def parameters_many(self, states: AutoState) -> tuple[Floats, Floats]:
        """What ``parameters`` gives valve by valve, both (M, 55)."""
        U, dp = (np.array(x, np.float64) for x in zip(*SITES, strict=True))
        Q, spread = np.empty((2, len(states.sizes), len(U)))
        sizes = np.ascontiguousarray(states.sizes[:, CHAMPION])
        is_spline = states.shapes[:, CHAMPION, ladder.CELLS_OF] > 0
        kernel.evaluate_many(
            np.ascontiguousarray(states.knots_U[:, CHAMPION]),
            np.ascontiguousarray(states.knots_s[:, CHAMPION]),
            memory.NODES_T,
            np.ascontiguousarray(states.coefficients[:, CHAMPION]),
            sizes,
            np.where(is_spline, sizes.prod(axis=1), 0),
            states.inverse,
            states.mixed,
            states.corner,
            U,
            dp,
            np.full_like(U, kernel.T_REFERENCE),
            Q,
            spread,
        )
        scalars, fitted = states.scalars[:, :, None], states.counters[:, memory.FITTED, None] > 0
        noise, gain = scalars[:, memory.VARIANCE], scalars[:, memory.GAIN_VARIANCE]
        return _known(Q, spread, noise, gain, fitted)

    def predict(self, state: AutoState, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats]:
        """Flow Q̂ (N,) in the middle of the hysteresis and its standard deviation (N,), l/min."""
        return self.predict_along(state, U, dp, T, np.zeros_like(U))

    def predict_along(
        self, state: AutoState, U: Floats, dp: Floats, T: Floats, direction: Floats
    ) -> tuple[Floats, Floats]:
        """Flow and standard deviation with U coming from below (1) or above (-1)."""
        n = shape_of(state, CHAMPION).size
        Q, spread = np.empty(len(U)), np.empty(len(U))
        kernel.evaluate(
            *surface_of(state, CHAMPION),
            state.inverse[:n].astype(np.float64),
            state.mixed[:n].astype(np.float64),
            state.corner,
            U,
            dp,
            T,
            direction,
            Q,
            spread,
        )
        fitted = np.asarray(state.counters[memory.FITTED] > 0)
        noise, gain = state.scalars[[memory.VARIANCE, memory.GAIN_VARIANCE]].tolist()
        return _known(Q, spread, noise, gain, fitted)

    def directions(self, state: AutoState, U: Floats) -> Floats:
        """Direction of U (N,) along a path of its own, for :meth:`predict_along`."""
        scalars = state.scalars.copy()
        scalars[memory.LAST_U] = math.nan
        play = shape_of(state, CHAMPION).play
        return np.array([memory.follow(u, play, scalars) for u in U], np.float64)

    def approached(self, state: AutoState, U: Floats) -> Floats:
        """U (N,) that brings the valve to where U in the middle of the hysteresis would hold it.

        From where the valve stands now: through its play in the direction it has to go. Less than
        an eighth of the loop is no reason to move.
        """
        last, play = float(state.scalars[memory.LAST_U]), shape_of(state, CHAMPION).play
        if not play or math.isnan(last):
            return U
        way = U - (last - play * float(state.scalars[memory.TOWARDS]))
        moved = np.clip(U + np.copysign(play, way), 0.0, 100.0)
        return np.where(np.abs(way) < play / 4.0, last, moved)

    def parameters(self, state: AutoState) -> tuple[Floats, Floats]:
        """Q at the 55 points and its standard deviation."""
        Q, std = self.parameters_many(alone(state))
        return Q[0], std[0]

    def adaptation(self, state: AutoState) -> Adaptation:
        """Undecided, as it does not look whether misfit or drift stays, or reacting."""
        reacting = state.scalars[memory.REACTS] > 0.0
        return Adaptation.REACTING if reacting else Adaptation.UNDECIDED

    def adaptation_many(self, states: AutoState) -> Codes:
        """`adaptation` of M models (M,)."""
        reacting = states.scalars[..., memory.REACTS] > 0.0
        return np.where(reacting, Adaptation.REACTING, Adaptation.UNDECIDED).astype(np.uint8)

    def to_map(self, state: AutoState) -> AutoMap:
        """Return the champion's map."""
        return AutoMap.of(state)

    def surface(self, state: AutoState) -> Surface:
        """Give the map itself, for its inverse."""
        return surface_of(state, CHAMPION)

    def describe(self, state: AutoState) -> str:
        """Which structure speaks now."""
        return shape_of(state, CHAMPION).describe()

    def structure_now(self, state: AutoState) -> Structure | None:
        """Eq. (7), where it speaks alone; None for a spline, known only where samples were."""
        return None if shape_of(state, CHAMPION).cells else FiveTerms()

    def lags(self, state: AutoState) -> tuple[float, float]:
        """Lag of U's effect and of the flow meter, s, as they are taken into account."""
        path = state.scalars[memory.LAGS :]
        return float(path[lag.LAG_U]), float(path[lag.LAG_Q])

    def describe_many(self, states: AutoState, chosen: Times) -> Sequence[str]:
        """What ``describe`` gives of chosen valves."""
        return [_described(shape.tobytes()) for shape in states.shapes[chosen, CHAMPION]]

    def lags_many(self, states: AutoState, chosen: Times) -> Sequence[tuple[float, float]]:
        """What ``lags`` gives of chosen valves."""
        path = states.scalars[chosen, memory.LAGS :]
        return list(zip(path[:, lag.LAG_U].tolist(), path[:, lag.LAG_Q].tolist(), strict=True))

    def largest_lags(self, states: AutoState) -> Floats:
        """The larger of the two `lags` of each of M valves, s (M,)."""
        path = states.scalars[..., memory.LAGS :]
        return np.maximum(path[..., lag.LAG_U], path[..., lag.LAG_Q])

    def too_fast(self, states: AutoState) -> Counts:
        """How many samples of each of M valves moved too fast for the lags to be learnt from."""
        return np.asarray(states.counters[..., memory.TOO_FAST])

    def began(self, states: AutoState) -> Counts:
        """After how many samples the map of each of M valves began anew; 0: it never did."""
        return states.counters[..., memory.BEGAN].copy()

    def samples_since(self, states: AutoState) -> Counts:
        """How many samples of each of M valves its map rests on, since it began."""
        return np.asarray(states.counters[..., memory.USED] - states.counters[..., memory.BEGAN])

    @property
    def uses_temperature(self) -> bool:
        """Whether the map may depend on the oil temperature: always."""
        return True

    @property
    def finds_changes(self) -> bool:
        """Whether changes are detected: always."""
        return True

    def change_counts(self, states: AutoState) -> Counts:
        """How many changes were found of each of M valves."""
        return np.asarray(states.counters[..., memory.ALARMS])

    def last_change(self, state: AutoState) -> Change | None:
        """Return the last change of the valve that was found, None if there was none."""
        counters = state.counters.tolist()
        if not counters[memory.ALARMS]:
            return None
        return Change(
            count=counters[memory.ALARMS],
            sample=counters[memory.CHANGE_SAMPLE],
            t=counters[memory.CHANGE_TIME],
            size=float(state.scalars[memory.CHANGE_SIZE]),
        )


def _known(
    Q: Floats,
    spread: Floats,
    noise: Floats | float,
    gain: Floats | float,
    fitted: NDArray[np.bool_],
) -> tuple[Floats, Floats]:
    """Flow and its standard deviation, NaN where nothing is known."""
    unknown = ~((spread < UNKNOWN) & fitted)
    with np.errstate(all="ignore"):
        std = np.sqrt(spread * noise + gain * Q**2)
    return np.where(unknown, np.nan, Q), np.where(unknown, np.nan, std)


@lru_cache(maxsize=1024)
def _described(shape: bytes) -> str:
    return Shape.from_array(np.frombuffer(shape)).describe()
