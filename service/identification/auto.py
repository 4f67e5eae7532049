"""`Auto`: the structure of the map chosen online, by prequential error and BIC."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import product
from typing import ClassVar, Final, Self

import numpy as np
from numpy.typing import NDArray

from service.identification import coloured_noise, drift, jitter, lag_search
from service.identification import fit_budget as budget
from service.identification.adaptation import Adaptation
from service.identification.change import Change
from service.identification.contents import Contents
from service.identification.estimator import State
from service.identification.fleet import alone, member, update_one
from service.identification.kernels import cells as memory
from service.identification.kernels import grid, held, ladder, lag, map_fit
from service.identification.kernels import surface as kernel
from service.identification.kernels.climb import IDLE
from service.identification.kernels.surface import Surface
from service.identification.map_search import (
    RICH,
    STARTS,
    climb,
    fit,
    fresh_start,
    is_better,
    is_resting,
    variety,
)
from service.identification.map_shapes import (
    AXES,
    BAND,
    CELLS,
    MOST,
    MOST_S,
    MOST_U,
    PRESSURES,
    Shape,
    Variety,
    dp_top,
)
from service.identification.model_structures import FiveTerms, Structure
from service.identification.samples import Codes, Floats, Quality, Samples, Segments, Times, Trace

CHAMPION, CHALLENGER, EXPLORER = 0, 1, 2
STARTED: Final = 0
ENOUGH_CELLS: Final = 24  # cells from which on shapes are compared
RESTING_STEPS: Final = 2  # neighbours tried at a fit once all were tried in vain
RESTED: Final = 60  # neighbours tried in vain from which on fits are rare
WORSE: Final = 1.02**2  # how much larger a challenger's squares may be that becomes champion
UNKNOWN: Final = 1e4  # variance over σ² of a map that says nothing
SPIKE, FEW = 30.0, 3.0  # usual misfits, samples: farther off and of fewer, a cell is a spike
NEW_START: Final = 1.25  # growth of the known cells that has the search start anew
FIRST_LOOK: Final = lag.ROWS  # samples kept before lags are looked for
SURE_AFTER: Final = 12_000  # samples: what changes before may still be the map itself
AFTER_CHANGE: Final = 300  # samples in which a map follows what is no lag
STAYS: Final = 0.5  # of the change's square: so large residuals are after one that is a lag
LAG_MOVED: Final = 0.15, 0.004  # share, s: a lag that moves farther has the map start anew
Counts = NDArray[np.int64]
SITES: Final = tuple(product(range(0, 101, 10), (5, 20, 50, 100, 150)))


@dataclass(frozen=True)
class AutoState(State):
    """What `Auto` knows; arrays of constant size.

    Attributes
    ----------
    cells : (640, 7) float32
        Weight and means of U, s, T, direction, Q and time of the samples of each cell that has a
        slot.
    slots : (3264,) uint16
        One more than the slot of each cell of the grid, see :mod:`kernels.grid`; 0 for none.
    recent : (704, 4) float32
        The last samples, for the search for lags, see :mod:`kernels.lag`.
    shapes : (3, 6), top : (1,)
        Shapes of champion, challenger and explorer, and the pressure their splines reach to, bar.
    knots_U, knots_s, coefficients, sizes : (2, …)
        The maps of champion and challenger, padded with 0; sizes (n_U, n_s).
    theta : (n + 8,)
        Parameters of the champion, padded with 0.
    inverse, mixed, corner
        The champion's inverse information, see :func:`kernels.map_fit.fit`; float32 but the last.
    scalars, counters
        See :mod:`kernels.cells`.
    progress : (3, 2)
        The explorer's starts so far, and of how many cells; how far challenger and explorer came
        in trying their neighbours, see :func:`map_search.climb`.
    """

    state_version: ClassVar[int] = 3  # 2: knew nothing of U that reacts

    cells: NDArray[np.float32]
    slots: NDArray[np.uint16]
    recent: NDArray[np.float32]
    shapes: Floats
    top: Floats
    knots_U: Floats
    knots_s: Floats
    coefficients: Floats
    sizes: Counts
    theta: Floats
    inverse: NDArray[np.float32]
    mixed: NDArray[np.float32]
    corner: Floats
    scalars: Floats
    counters: Counts
    progress: Counts

    def contents(self) -> Mapping[str, Contents]:
        """What may stand in them; places that kernels count by lie within their arrays."""
        every, path = slice(None), memory.LAGS
        scalars = Contents(self.scalars).within(-1.0, 1.0, memory.TOWARDS)
        scalars.or_nan([memory.LAST_U, memory.VARIANCE, memory.LEFT_U])
        scalars.or_nan([path + k for k in (lag.U_EFFECT, lag.Q_METERED, lag.RIVAL_METERED)])
        of_noise = [memory.NOISE, memory.NOISE_WEIGHT, memory.POWER, memory.VARIANCE]
        scalars.within(0.0, where=of_noise)
        scalars.within(0.0, 1.0, memory.REACTS)
        scalars.within(0.0, where=[path + lag.LAG_U, path + lag.LAG_Q])
        counters = Contents(self.counters).within(0, 1, [memory.FITTED, memory.FRESH])
        counters.any_time([memory.SUSPECT_TIME, memory.CHANGE_TIME, memory.CLOCK])
        counters.any_time([memory.LAGGING + lag.TIME, memory.LAGGING + lag.KEPT_TIME])
        counters.any_time([memory.NEXT_LOOK, memory.NEW_CELLS, memory.SPENT])
        counters.within(0, grid.SLOTS, memory.TAKEN)
        shapes = Contents(self.shapes).within(0.0, CELLS[-1], (every, ladder.CELLS_OF))
        shapes.within(0.0, len(AXES) - 1.0, (every, ladder.AXIS))
        shapes.within(0.0, ladder.MOST_DEAD, (every, ladder.DEAD_BAND))
        shapes.within(ladder.LEAST_FULL, 100.0, (every, ladder.SATURATION))
        shapes.within(0.0, ladder.MOST_PLAY, (every, ladder.PLAY))
        shapes.within(0.0, 1.0, (every, ladder.TREND))
        shapes.or_nan((every, [ladder.DEAD_BAND, ladder.SATURATION]))
        return {
            "cells": Contents(self.cells).within(0.0, where=(every, grid.WEIGHT)),
            "slots": Contents(self.slots).within(0, grid.SLOTS),
            "shapes": shapes,
            "top": Contents(self.top).within(PRESSURES[0], PRESSURES[-1]),
            "sizes": Contents(self.sizes).within(0, MOST),
            "scalars": scalars,
            "counters": counters,
        }

    def is_coherent(self) -> bool:
        """Whether shapes are steps of the ladder, and the maps as large as their shapes."""
        whole = [ladder.CELLS_OF, ladder.AXIS, ladder.TREND]
        known = (self.shapes[:, whole] == np.rint(self.shapes[:, whole])).all()
        if not known or not np.isin(self.shapes[:, ladder.CELLS_OF], CELLS).all():
            return False
        return all(_is_of_its_shape(self, which) for which in (CHAMPION, CHALLENGER)) and (
            _shape(self, EXPLORER).size <= MOST
        )


@dataclass(frozen=True)
class Auto:
    """Chooses the structure of the map online, and with it identifies the map.

    A grid of cells over (U, √dp), split by temperature and direction of U, remembers the mean of
    the samples that fell into each. To these means, weighted by their numbers, any structure is
    fitted by least squares, eq. (16), when news and the budget
    (:mod:`~service.identification.fit_budget`) call for it. The ladder
    (:class:`~service.identification.map_shapes.Shape`) leads from eq. (7) to cubic tensor splines
    of many cells, with a dead band, a saturation, hysteresis (U lags by half its width) and a trend
    with temperature.

    U's effect may lag behind U, and the meter behind the flow, both of first order. The lags are
    those that leave least unexplained in the last samples (:mod:`~service.identification
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
        Forgetting factor of a cell, per sample that falls into it; 0 < lam <= 1.
    steps
        Steps of the ladder tried at each fit, at most.
    lag_U, lag_Q
        First-order lag of U's effect and of the flow meter, s; None: looked for.

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
    lag_U: float | None = None
    lag_Q: float | None = None

    def __post_init__(self) -> None:
        for name in ("lag_U", "lag_Q"):
            tau = getattr(self, name)
            if tau is not None and not 0.0 <= tau < math.inf:
                raise ValueError(f"{name} = {tau!r} s is not a time")
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
        scalars[[memory.LAST_U, memory.VARIANCE, memory.LEFT_U]] = math.nan
        path = scalars[memory.LAGS :]
        path[lag.U_EFFECT] = path[lag.Q_METERED] = path[lag.RIVAL_METERED] = math.nan
        path[lag.LAG_U], path[lag.LAG_Q] = self.lag_U or 0.0, self.lag_Q or 0.0
        counters = np.zeros(memory.COUNTERS, np.int64)
        counters[[memory.NEXT_FIT, memory.NEW_CELLS]] = budget.FIRST_FIT
        looked_for = self.lag_U is None or self.lag_Q is None
        counters[memory.NEXT_LOOK] = FIRST_LOOK if looked_for else np.iinfo(np.int64).max
        return AutoState(
            cells=np.zeros((grid.SLOTS, len(grid.COLUMNS)), np.float32),
            slots=np.zeros(grid.PLACES * grid.CELLS_OF_A_PLACE, np.uint16),
            recent=np.zeros((lag.ROWS, 4), np.float32),
            shapes=np.stack([Shape().to_array()] * 3),
            top=np.array([dp_top(0.0)]),
            knots_U=np.zeros((2, MOST_U + 4)),
            knots_s=np.zeros((2, MOST_S + 4)),
            coefficients=np.zeros((2, 2 * MOST)),
            sizes=np.zeros((2, 2), np.int64),
            theta=np.zeros(MOST + kernel.BORDER),
            inverse=np.zeros((MOST, BAND), np.float32),
            mixed=np.zeros((MOST, kernel.BORDER), np.float32),
            corner=np.zeros((kernel.BORDER, kernel.BORDER)),
            scalars=scalars,
            counters=counters,
            progress=np.zeros((3, 2), np.int64),
        )

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
        segment, row = 0, int(segments.starts[0]) if len(segments.starts) else 0
        with np.errstate(all="ignore"):
            while segment < len(segments.members):
                segment, row = memory.run_many(segment, row, batch, *segments, longest, fleet)
                if segment < len(segments.members):
                    self._attend(member(states, int(segments.members[segment])))
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
        n = _shape(state, CHAMPION).size
        Q, spread = np.empty(len(U)), np.empty(len(U))
        kernel.evaluate(
            *_surface(state, CHAMPION),
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

    def surface(self, state: AutoState) -> Surface:
        """Give the map itself, for its inverse."""
        return _surface(state, CHAMPION)

    def describe(self, state: AutoState) -> str:
        """Which structure speaks now."""
        return _shape(state, CHAMPION).describe()

    def structure_now(self, state: AutoState) -> Structure | None:
        """Eq. (7), where it speaks alone; None for a spline, known only where samples were."""
        return None if _shape(state, CHAMPION).cells else FiveTerms()

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

    def _attend(self, state: AutoState) -> None:
        """Do what is due of one valve; its state is written in place."""
        kept = int(state.counters[memory.LAGGING + lag.KEPT_ROWS])
        self._doubt_lags(state, kept)
        if kept >= state.counters[memory.NEXT_LOOK]:
            self._look_for_lags(state, kept)
            since = kept - int(state.counters[memory.LAGGING + lag.LOOKED_FROM])
            state.counters[memory.NEXT_LOOK] = kept + max(since, lag.ROWS)
        if memory.is_due(state.counters):
            self._refit(state)

    def _doubt_lags(self, state: AutoState, kept: int) -> None:
        """After a change that no map follows look for lags soon, and as often as at first."""
        counters = state.counters
        looked_for = self.lag_U is None or self.lag_Q is None
        at = counters[memory.CHANGE_SAMPLE]
        is_new = AFTER_CHANGE <= counters[memory.USED] - at < lag.ROWS
        size, variance = state.scalars[[memory.CHANGE_SIZE, memory.VARIANCE]]
        stays = at > SURE_AFTER and variance > STAYS * size * size
        if (
            looked_for
            and counters[memory.ALARMS]
            and is_new
            and stays
            and counters[memory.NEXT_LOOK] > kept + lag.ROWS
        ):
            counters[memory.NEXT_LOOK] = kept + lag.ROWS
            counters[memory.LAGGING + lag.LOOKED_FROM] = kept

    def _look_for_lags(self, state: AutoState, kept: int) -> None:
        """Weigh what the last samples say of the lags; where they move, the map starts anew."""
        rows = _last_rows(state)
        path = state.scalars[memory.LAGS :]
        before = float(path[lag.LAG_U]), float(path[lag.LAG_Q])
        since = int(state.counters[memory.LAGGING + lag.LOOKED_FROM])
        doubted = before if since > 0 and kept - since <= lag.ROWS else None
        given = self.lag_U, self.lag_Q
        found = lag_search.look(rows, path[lag.KNOWN_LAGS :], given, doubted)
        share, least = LAG_MOVED
        moved = any(abs(b - a) > max(least, share * a) for a, b in zip(before, found, strict=True))
        path[lag.LAG_U], path[lag.LAG_Q] = found
        if moved:
            self._start_anew(state)

    def _start_anew(self, state: AutoState) -> None:
        """Forget the map, and keep what is known of time, lags and changes."""
        fresh, path = self.initial_state(), state.scalars[memory.LAGS :].copy()
        path[[lag.Q_METERED, lag.RIVAL_METERED]] = math.nan
        kept = [
            *(memory.USED, memory.ALARMS, memory.NEXT_LOOK, memory.TOO_FAST),
            *(memory.CHANGE_SAMPLE, memory.CHANGE_TIME),
            *range(memory.LAGGING, memory.COUNTERS),
        ]
        counters, size = fresh.counters, state.scalars[memory.CHANGE_SIZE]
        counters[kept] = state.counters[kept]
        counters[memory.OPENED] = counters[memory.USED]
        counters[memory.NEXT_FIT] += counters[memory.USED]
        for field in fields(state):
            if field.name != "recent":
                getattr(state, field.name)[...] = getattr(fresh, field.name)
        state.scalars[memory.LAGS :], state.scalars[memory.CHANGE_SIZE] = path, size

    def _refit(self, state: AutoState) -> None:
        """Promote the challenger if it did well, let it climb, fit both."""
        scalars, counters, progress = state.scalars, state.counters, state.progress
        now = counters[memory.LAGGING + lag.TIME]
        ahead = drift.set_clock(state.cells, scalars, 1e-9 * float(now - counters[memory.CLOCK]))
        counters[memory.CLOCK] = now
        if (reacts := jitter.reacts(_last_rows(state))) is not None:
            scalars[memory.REACTS] = reacts
        coloured_noise.reckon(state.cells, scalars)
        points = _trusted(state, ahead)
        if not len(points):
            budget.next_fit(counters, 0, at_rest=False)
            return
        top = dp_top(float(points[:, grid.MEAN_S].max()))
        champion, challenger, explorer = (Shape.from_array(shape) for shape in state.shapes)
        if scalars[memory.CHALLENGER_SQUARES] <= WORSE * scalars[memory.CHAMPION_SQUARES]:
            champion = challenger
        if counters[memory.NEW_CELLS] <= 0:
            progress[CHALLENGER, IDLE] = 0
        if len(points) > NEW_START * progress[STARTED, 1]:
            progress[STARTED] = 0, len(points)
        if len(points) >= ENOUGH_CELLS:
            shared = held.shared(state.slots, state.cells)
            varied = variety(shared, points, sum(self.lags(state)))
            least = coloured_noise.least_variance(scalars)
            challenger, explorer = self._climb(
                points, challenger, explorer, top, varied, state, least
            )
        best = fit(points, champion, top)
        rival = best if challenger == champion else fit(points, challenger, top)
        budget.spend(counters, 2 * _cost(points, challenger))
        freedom = max(len(points) - best.n_effective, 1.0)
        scalars[memory.VARIANCE] = max(
            best.rss / freedom, scalars[memory.NOISE], scalars[memory.POWER]
        )
        scalars[memory.EXCITATION] = best.n_effective
        scalars[[memory.CHAMPION_SQUARES, memory.CHALLENGER_SQUARES]] = 0.0
        at_rest = champion == challenger and progress[CHALLENGER, IDLE] > RESTED
        at_rest = at_rest and not drift.is_sure(scalars)
        budget.next_fit(counters, len(points), at_rest=at_rest)
        counters[[memory.FITTED, memory.FRESH]] = 1
        state.shapes[:] = [x.to_array() for x in (champion, challenger, explorer)]
        state.top[0] = top
        n = champion.size
        state.theta[:] = 0.0
        state.theta[:n], state.theta[MOST:] = best.theta[:n], best.theta[n:]
        state.inverse[:n], state.mixed[:n], state.corner[:] = best.inverse, best.mixed, best.corner
        state.inverse[n:], state.mixed[n:] = 0.0, 0.0
        for which, shape, found in ((CHAMPION, champion, best), (CHALLENGER, challenger, rival)):
            write_map(state, which, shape, found.theta, top)

    def _climb(
        self,
        points: Floats,
        challenger: Shape,
        explorer: Shape,
        top: float,
        varied: Variety,
        state: AutoState,
        least: float,
    ) -> tuple[Shape, Shape]:
        """Let the challenger climb; once it rests on a summit, the explorer, from other starts."""
        progress, counters = state.progress, state.counters
        rich, rich_elsewhere = np.zeros((2, RICH))  # of these points, nothing is known yet
        resting = is_resting(challenger, varied, progress[CHALLENGER])
        steps = self._affordable(counters, points, challenger)
        steps = min(steps, RESTING_STEPS) if resting else steps
        if steps < 1:
            return challenger, explorer
        challenger = climb(
            points, challenger, top, varied, steps, progress[CHALLENGER], least, rich
        )
        budget.spend(counters, (steps + 2) * _cost(points, challenger))
        if not resting or progress[STARTED, 0] > len(STARTS):
            return challenger, explorer
        if is_resting(explorer, varied, progress[EXPLORER]) or not progress[STARTED, 0]:
            explorer = fresh_start(progress[STARTED, 0], challenger)
            progress[STARTED, 0] += 1
            progress[EXPLORER] = 0
        steps = self._affordable(counters, points, explorer)
        if steps < 1:
            return challenger, explorer
        explorer = climb(
            points, explorer, top, varied, steps, progress[EXPLORER], least, rich_elsewhere
        )
        budget.spend(counters, (steps + 5) * _cost(points, explorer))
        if progress[EXPLORER, IDLE] and is_better(points, explorer, challenger, top, least, rich):
            challenger = explorer
            progress[CHALLENGER] = 0
        return challenger, explorer

    def _affordable(self, counters: Counts, points: Floats, shape: Shape) -> int:
        """Steps of the ladder that the budget allows now."""
        return budget.steps(counters, _cost(points, shape), self.steps)


def write_map(state: AutoState, which: int, shape: Shape, theta: Floats, top: float) -> None:
    """Write the map of champion or challenger as the kernels take it."""
    plan = shape.plan(top)
    n_U, n_s = len(plan.sites_U), len(plan.sites_s)
    table = np.empty((n_U, n_s, 2))
    map_fit.coefficients(plan, theta, table)
    state.sizes[which] = n_U, n_s
    state.knots_U[which, : n_U + 4], state.knots_s[which, : n_s + 4] = plan.knots_U, plan.knots_s
    state.coefficients[which, : table.size] = table.ravel()


def _last_rows(state: AutoState) -> Floats:
    """The last samples kept, in the order of time."""
    kept = int(state.counters[memory.LAGGING + lag.KEPT_ROWS])
    rows = np.roll(state.recent, -(kept % lag.ROWS), axis=0) if kept >= lag.ROWS else state.recent
    return rows[:kept].astype(np.float64)


def _is_of_its_shape(state: AutoState, which: int) -> bool:
    n_U, n_s = state.sizes[which].tolist()
    shape = _shape(state, which)
    if not n_U:
        return not n_s and not shape.size
    plan = shape.plan(float(state.top[0]))
    return (
        shape.size <= MOST
        and (n_U, n_s) == (len(plan.sites_U), len(plan.sites_s))
        and np.array_equal(state.knots_U[which, : n_U + 4], plan.knots_U)
        and np.array_equal(state.knots_s[which, : n_s + 4], plan.knots_s)
    )


def _cost(points: Floats, shape: Shape) -> int:
    band = 3 * (len(AXES[shape.axis]) + 2) + 4
    return budget.cost(len(points), shape.size, band)


def _trusted(state: AutoState, ahead: float) -> Floats:
    """Cells that hold samples, as they will be in ``ahead`` s.

    But for those of a few samples far off all others: spikes.
    """
    points = drift.carried(held.points(state.cells), state.scalars, ahead)
    if not state.counters[memory.FITTED] or not len(points):
        return points
    misfit = kernel.misfit(_surface(state, CHAMPION), points)
    usual = max(
        float(np.partition(misfit, len(misfit) // 2)[len(misfit) // 2]),
        math.sqrt(state.scalars[memory.NOISE]),
        1e-4 * float(np.abs(points[:, grid.MEAN_Q]).max()),
    )
    spiked = (misfit > SPIKE * usual) & (points[:, grid.WEIGHT] < FEW)
    return points[~spiked]


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


def _surface(state: AutoState, which: int) -> Surface:
    n_U, n_s = state.sizes[which].tolist()
    if not n_U:
        return Surface(np.zeros(8), np.zeros(8), memory.NODES_T, np.zeros((4, 4, 2)), 0.0)
    table = state.coefficients[which, : 2 * n_U * n_s].reshape(n_U, n_s, 2)
    return Surface(
        state.knots_U[which, : n_U + 4],
        state.knots_s[which, : n_s + 4],
        memory.NODES_T,
        table,
        _shape(state, which).play,
    )


def _shape(state: AutoState, which: int) -> Shape:
    return Shape.from_array(state.shapes[which])
