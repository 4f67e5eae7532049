"""`Auto`: the structure of the map chosen online, by prequential error and BIC."""

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from service.identification.adaptation import Adaptation
from service.identification.estimator import State
from service.identification.kernels import cells as memory
from service.identification.kernels import surface as kernel
from service.identification.kernels.surface import Surface
from service.identification.map_search import (
    BAND,
    IDLE,
    MOST,
    STARTS,
    climb,
    fit,
    fresh_start,
    is_better,
    is_resting,
    variety,
)
from service.identification.map_shapes import NODES_T, Shape, Variety, dp_top
from service.identification.model_structures import FiveTerms, Structure
from service.identification.samples import Floats, Quality, Samples, Trace

CHAMPION, CHALLENGER, EXPLORER = 0, 1, 2
STARTED: Final = 0
ENOUGH_CELLS: Final = 24
RESTING_STEPS: Final = 2
RESTED: Final = 60
SHORTEST_WAIT, TRIAL, LONGEST_WAIT = 16, 64, 512
UNKNOWN: Final = 1e4
SPIKE, FEW = 30.0, 3.0
Counts = NDArray[np.int64]
SITES: Final = tuple(product(range(0, 101, 10), (5, 20, 50, 100, 150)))


@dataclass(frozen=True)
class AutoState(State):
    """What `Auto` knows; arrays of constant size.

    Attributes
    ----------
    cells : (5040, 6)
        Weight and means of U, s, T, direction and Q of each cell's samples.
    shapes : (3, 6), top : ()
        Shapes of champion, challenger and explorer, and the pressure their splines reach to, bar.
    theta : (2, n + 8)
        Parameters of champion and challenger, padded with 0.
    inverse, mixed, corner
        The champion's inverse information, see :func:`kernels.surface.fit`.
    scalars, counters
        See :mod:`kernels.cells`.
    progress : (3, 2)
        The explorer's starts so far, and of how many cells; how far challenger and explorer came
        in trying their neighbours, see :func:`map_search.climb`.
    """

    cells: Floats
    shapes: Floats
    top: Floats
    theta: Floats
    inverse: Floats
    mixed: Floats
    corner: Floats
    scalars: Floats
    counters: Counts
    progress: Counts


@dataclass(frozen=True)
class Auto:
    """Chooses the structure of the map online, and with it identifies the map.

    A grid of cells over (U, √dp), split by temperature and direction of U, remembers the mean of
    the samples that fell into each. To these means, weighted by their numbers, any structure is
    fitted by least squares, eq. (16), whenever some more samples are in. The ladder
    (:class:`~service.identification.map_shapes.Shape`) leads from eq. (7) to cubic tensor splines
    of many cells, with a dead band, a saturation, hysteresis (U lags by half its width) and a trend
    with temperature.

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
        Forgetting factor of a cell, per sample that falls into it; 0 < lam <= 1.
    steps
        Steps of the ladder tried at each fit.

    Examples
    --------
    >>> from service.identification.samples import Samples
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

    lam: float = 0.998
    steps: int = 16

    def __post_init__(self) -> None:
        if not 0.0 < self.lam <= 1.0:
            raise ValueError(f"forgetting factor lam = {self.lam!r} is not in (0, 1]")

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the points at which the map is published."""
        return tuple(f"Q({U}%,{dp}bar)" for U, dp in SITES)

    def with_forgetting(self, lam: float) -> Self:
        """Use another forgetting factor; states may be carried over."""
        return replace(self, lam=lam)

    def initial_state(self) -> AutoState:
        """State before the first sample."""
        scalars = np.zeros(memory.SCALARS)
        scalars[memory.LAST_U] = scalars[memory.VARIANCE] = math.nan
        counters = np.zeros(memory.COUNTERS, np.int64)
        counters[[memory.NEXT_FIT, memory.NEW_CELLS]] = 8
        return AutoState(
            cells=np.zeros((memory.CELLS_U * memory.CELLS_S * memory.CELLS_T * 2, 6)),
            shapes=np.stack([Shape().to_array()] * 3),
            top=np.array(dp_top(0.0)),
            theta=np.zeros((2, MOST + kernel.BORDER)),
            inverse=np.zeros((MOST, BAND)),
            mixed=np.zeros((MOST, kernel.BORDER)),
            corner=np.zeros((kernel.BORDER, kernel.BORDER)),
            scalars=scalars,
            counters=counters,
            progress=np.zeros((3, 2), np.int64),
        )

    def update(self, state: AutoState, samples: Samples) -> tuple[AutoState, Trace]:
        """Take N samples in, one after another."""
        N = len(samples)
        predicted, residual = np.empty((2, N))
        trace = Trace(predicted, residual, residual, np.empty(N, np.uint8))
        usable = samples.quality != Quality.BAD
        longest = math.inf if self.lam == 1.0 else 1.0 / (1.0 - self.lam)
        dp, done = samples.dp, 0
        state = replace(
            state,
            cells=state.cells.copy(),
            scalars=state.scalars.copy(),
            counters=state.counters.copy(),
        )
        with np.errstate(all="ignore"):
            while done < N:
                done = memory.run(
                    done,
                    samples.U,
                    dp,
                    samples.T,
                    samples.Q,
                    usable,
                    longest,
                    state.cells,
                    _surface(state, CHAMPION),
                    _surface(state, CHALLENGER),
                    state.scalars,
                    state.counters,
                    trace.predicted,
                    trace.residual,
                    trace.status,
                )
                if memory.is_due(state.counters):
                    state = self._refit(state)
        return state, trace

    def predict(self, state: AutoState, U: Floats, dp: Floats, T: Floats) -> tuple[Floats, Floats]:
        """Flow Q̂ (N,) in the middle of the hysteresis and its standard deviation (N,), l/min."""
        return self.predict_along(state, U, dp, T, np.zeros_like(U))

    def predict_along(
        self, state: AutoState, U: Floats, dp: Floats, T: Floats, direction: Floats
    ) -> tuple[Floats, Floats]:
        """Flow and standard deviation with U coming from below (1) or above (-1)."""
        n = _shape(state, CHAMPION).size
        Q, spread = np.empty(len(U)), np.empty(len(U))
        kernel.evaluate(
            *_surface(state, CHAMPION),
            state.inverse[:n],
            state.mixed[:n],
            state.corner,
            U,
            dp,
            T,
            direction,
            Q,
            spread,
        )
        unknown = ~(spread < UNKNOWN) | (state.counters[memory.FITTED] == 0)
        with np.errstate(all="ignore"):
            std = np.sqrt(spread * state.scalars[memory.VARIANCE])
        return np.where(unknown, np.nan, Q), np.where(unknown, np.nan, std)

    def directions(self, state: AutoState, U: Floats) -> Floats:
        """Direction of U (N,) along a path of its own, for :meth:`predict_along`."""
        scalars = state.scalars.copy()
        scalars[memory.LAST_U] = math.nan
        play = _shape(state, CHAMPION).play
        return np.array([memory.follow(u, play, scalars) for u in U], np.float64)

    def approached(self, state: AutoState, U: Floats) -> Floats:
        """U (N,) that brings the valve to where U in the middle of the hysteresis would hold it.

        From where the valve stands now: through its play in the direction it has to go. Less than
        an eighth of the loop is no reason to move.
        """
        last, play = float(state.scalars[memory.LAST_U]), _shape(state, CHAMPION).play
        if not play or math.isnan(last):
            return U
        way = U - (last - play * float(state.scalars[memory.TOWARDS]))
        moved = np.clip(U + np.copysign(play, way), 0.0, 100.0)
        return np.where(np.abs(way) < play / 4.0, last, moved)

    def parameters(self, state: AutoState) -> tuple[Floats, Floats]:
        """Q at the 55 points and its standard deviation."""
        U, dp = (np.array(x, np.float64) for x in zip(*SITES, strict=True))
        return self.predict(state, U, dp, np.full_like(U, kernel.T_REFERENCE))

    def adaptation(self, _state: AutoState) -> Adaptation:
        """Steady: it forgets at one pace."""
        return Adaptation.STEADY

    def surface(self, state: AutoState) -> Surface:
        """Give the map itself, for its inverse."""
        return _surface(state, CHAMPION)

    def describe(self, state: AutoState) -> str:
        """Which structure speaks now."""
        return _shape(state, CHAMPION).describe()

    def structure_now(self, state: AutoState) -> Structure | None:
        """Eq. (7), where it speaks alone; None for a spline, known only where samples were."""
        return None if _shape(state, CHAMPION).cells else FiveTerms()

    def _refit(self, state: AutoState) -> AutoState:
        """Promote the challenger if it did well, let it climb, fit both; a pure function."""
        points = _trusted(state)
        top = dp_top(float(points[:, memory.MEAN_S].max()))
        scalars, counters = state.scalars.copy(), state.counters.copy()
        champion, challenger, explorer = (Shape.from_array(shape) for shape in state.shapes)
        squares = scalars[memory.CHAMPION_SQUARES], scalars[memory.CHALLENGER_SQUARES]
        if squares[1] <= 1.02**2 * squares[0]:
            champion = challenger
        progress = state.progress.copy()
        if counters[memory.NEW_CELLS] <= 0:
            progress[CHALLENGER, IDLE] = 0
        if len(points) > 1.25 * progress[STARTED, 1]:
            progress[STARTED] = 0, len(points)
        if len(points) >= ENOUGH_CELLS:
            varied = variety(state.cells, points)
            challenger, explorer = self._climb(points, challenger, explorer, top, varied, progress)
        best, rival = fit(points, champion, top), fit(points, challenger, top)
        freedom = max(len(points) - best.n_effective, 1.0)
        scalars[memory.VARIANCE] = max(best.rss / freedom, scalars[memory.NOISE])
        scalars[memory.EXCITATION] = best.n_effective
        scalars[[memory.CHAMPION_SQUARES, memory.CHALLENGER_SQUARES]] = 0.0
        since = counters[memory.USED] - counters[memory.OPENED]
        at_rest = champion == challenger and progress[CHALLENGER, IDLE] > RESTED
        longest = LONGEST_WAIT if at_rest else TRIAL
        counters[memory.NEXT_FIT] = counters[memory.USED] + min(
            max(since // 16, SHORTEST_WAIT), longest
        )
        counters[memory.NEW_CELLS] = max(8, len(points) // 24)
        counters[memory.FITTED] = 1
        return replace(
            state,
            shapes=np.stack([x.to_array() for x in (champion, challenger, explorer)]),
            top=np.array(top),
            theta=np.stack([_padded(best.theta), _padded(rival.theta)]),
            inverse=best.inverse,
            mixed=best.mixed,
            corner=best.corner,
            scalars=scalars,
            counters=counters,
            progress=progress,
        )

    def _climb(
        self,
        points: Floats,
        challenger: Shape,
        explorer: Shape,
        top: float,
        varied: Variety,
        progress: Counts,
    ) -> tuple[Shape, Shape]:
        """Let the challenger climb; once it rests on a summit, the explorer, from other starts."""
        resting = is_resting(challenger, varied, progress[CHALLENGER])
        steps = RESTING_STEPS if resting else self.steps
        challenger = climb(points, challenger, top, varied, steps, progress[CHALLENGER])
        if not resting or progress[STARTED, 0] > len(STARTS):
            return challenger, explorer
        if is_resting(explorer, varied, progress[EXPLORER]) or not progress[STARTED, 0]:
            explorer = fresh_start(progress[STARTED, 0], challenger)
            progress[STARTED, 0] += 1
            progress[EXPLORER] = 0
        explorer = climb(points, explorer, top, varied, self.steps, progress[EXPLORER])
        if progress[EXPLORER, IDLE] and is_better(points, explorer, challenger, top):
            challenger = explorer
            progress[CHALLENGER] = 0
        return challenger, explorer


def _trusted(state: AutoState) -> Floats:
    """Cells that hold samples, but for those of a few samples far off all others: spikes."""
    points = state.cells[state.cells[:, memory.WEIGHT] > 0.0]
    if not state.counters[memory.FITTED]:
        return points
    misfit = kernel.misfit(_surface(state, CHAMPION), points)
    usual = max(
        float(np.median(misfit)),
        math.sqrt(state.scalars[memory.NOISE]),
        1e-4 * float(np.abs(points[:, memory.MEAN_Q]).max()),
    )
    spiked = (misfit > SPIKE * usual) & (points[:, memory.WEIGHT] < FEW)
    return points[~spiked]


def _surface(state: AutoState, which: int) -> Surface:
    shape, top = _shape(state, which), float(state.top)
    spline = shape.spline(top)
    theta = np.concatenate([state.theta[which, : shape.size], state.theta[which, MOST:]])
    coefficients = np.ascontiguousarray(shape.coefficients(theta, top))
    return Surface(spline.knots[0], spline.knots[1], NODES_T, coefficients, shape.play)


def _shape(state: AutoState, which: int) -> Shape:
    return Shape.from_array(state.shapes[which])


def _padded(theta: Floats) -> Floats:
    padded = np.zeros(MOST + kernel.BORDER)
    n = len(theta) - kernel.BORDER
    padded[:n], padded[MOST:] = theta[:n], theta[n:]
    return padded
