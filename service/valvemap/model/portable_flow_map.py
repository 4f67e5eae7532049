"""The map of `FlowMap` as a value: what a prediction needs, and nothing that an update needs."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from valvemap.model import flow_map_looks
from valvemap.model.drift_states import VALVE_STATES
from valvemap.model.fleet import copied
from valvemap.model.flow_map_state import FlowMapState, Range, axes, empty
from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_memory as memory
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_play as plays
from valvemap.model.kernels import flow_reading as readings
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels import flow_wear as wears
from valvemap.model.samples import Floats, Singles

SCALARS: Final = (
    *(fits.VARIANCE, fits.MISFIT, fits.SCALE, fits.PLAIN, fits.LEAST),
    *(fits.PAIR_PRODUCT, fits.PAIRS, fits.PAIR_SQUARE),
    *(fits.READING + readings.PART, fits.READING + readings.MEAN),
)
FIRST_SCALARS: Final = 5  # of models of before, which did not know what errors have in common
TEMPERATURES: Final = fits.FIRST_T, fits.LEARNT_T
MOVING: Final = 2, 1 + len(VALVE_STATES), len(VALVE_STATES)
_PLACES: Final = np.ix_(np.arange(2), np.append(0, 1 + VALVE_STATES), VALVE_STATES)


@dataclass(frozen=True)
class GaussianMap:
    """A map of `FlowMap`.

    Attributes
    ----------
    U_range, dp_range
        Of the valve, % and bar; they place the n sites of the splines.
    theta, std : (n,)
        Coefficients of the map, and its standard deviation at the sites, with the doubt about
        operators, l/min.
    moving : (2, 10, 9)
        What moves in time on either side of U = 0: its mean, then its covariance.
    scalars, temperatures : (10,), (2,)
        See `SCALARS`; that of the first sample, and the mean, °C, NaN where unknown.
    operators, play : (13,), (2,)
        Between the map and the samples; half the play, %, and the information about it.
    """

    U_range: Range
    dp_range: Range
    theta: Singles
    std: Floats
    moving: Floats
    scalars: Floats
    temperatures: Floats
    operators: Floats
    play: Floats

    @classmethod
    def of(cls, state: FlowMapState, U_range: Range, dp_range: Range) -> Self:
        """Return the map of a state.

        Raises
        ------
        ValueError
            if it is not determined yet.
        """
        if not state.counters[memory.FITTED]:
            raise ValueError("its map is not determined yet")
        return cls(
            U_range=U_range,
            dp_range=dp_range,
            theta=state.theta.copy(),
            std=np.sqrt(
                state.std.astype(np.float64) ** 2
                + state.doubt.astype(np.float64) ** 2
                + _worn(state, U_range, dp_range)
                + _unnoticed(state, U_range, dp_range)
            ),
            moving=state.now[_PLACES],
            scalars=state.scalars[list(SCALARS)],
            temperatures=state.scalars[list(TEMPERATURES)],
            operators=state.path[: paths.OF_MAP].copy(),
            play=state.play[[plays.HALF, plays.SLOPES]],
        )

    def state(self) -> FlowMapState:
        """Return a state with this map, and nothing that an update needs.

        Raises
        ------
        ValueError
            if arrays do not have the sizes that the ranges ask for.
        """
        blank = empty(*axes(self.U_range, self.dp_range))
        moving = blank.now[_PLACES]
        for name, wanted in (("theta", blank.theta), ("std", blank.std), ("moving", moving)):
            given = getattr(self, name)
            if given.shape != wanted.shape:
                raise ValueError(f"{name}: {given.size} numbers; {wanted.size} are allowed")
            wanted[:] = given
        blank.now[_PLACES] = moving
        blank.scalars[list(SCALARS)] = self.scalars
        blank.scalars[list(TEMPERATURES)] = self.temperatures
        blank.scalars[fits.NOW_T] = self.temperatures[1]
        blank.path[: paths.OF_MAP] = self.operators
        blank.play[[plays.HALF, plays.SLOPES]] = self.play
        blank.counters[memory.FITTED] = 1
        return blank


def _unnoticed(state: FlowMapState, U_range: Range, dp_range: Range) -> Floats:
    """Variance at the sites by drifts of sensors until they were noticed (n,)."""
    both, without = axes(U_range, dp_range), copied(state)
    without.chance[:, drifts.SENSING] = 0.0
    U, s = (x.ravel() for x in np.meshgrid(both[0].sites, both[1].sites, indexing="ij"))
    U, s = (np.clip(x, of.breaks[0], of.breaks[-1]) for x, of in zip((U, s), both, strict=True))
    asked = U, s * np.abs(s), np.full(len(U), state.scalars[fits.NOW_T])
    std, less = (flow_map_looks.predict(x, both, *asked)[1] for x in (state, without))
    return np.asarray(std**2 - less**2)


def _worn(state: FlowMapState, U_range: Range, dp_range: Range) -> Floats:
    """Variance at the sites by `kernels.flow_wear`, where it matters (n,)."""
    axis_U, axis_s = axes(U_range, dp_range)
    of_U = np.zeros(len(axis_U.sites))
    for side, end in enumerate((axis_U.breaks[-1], axis_U.breaks[0])):
        nodes, head = state.wear[side, : wears.NODES], state.wear[side, wears.NODES]
        if head[wears.CHANCE] > rules.ODDS:
            variance = nodes[:, wears.P_LEVEL] + nodes[:, wears.LEVEL] ** 2
            at = np.linspace(0.0, abs(end), wears.NODES)
            here = axis_U.sites >= 0.0 if side == 0 else axis_U.sites < 0.0
            known = np.interp(np.abs(axis_U.sites), at, head[wears.CHANCE] * variance)
            of_U[here] = known[here]
    return np.outer(of_U, (axis_s.sites / axis_s.breaks[-1]) ** 2).ravel()
