"""What `FlowMap` knows: cells, the map, its standard deviation, hyper-parameters."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from valvemap.model import drift_states, flow_rivals
from valvemap.model.contents import Contents
from valvemap.model.estimator import State
from valvemap.model.kernels import (
    flow_begun,
    flow_cells,
    flow_drift,
    flow_fit,
    flow_memory,
    flow_path,
    flow_play,
    flow_slopes,
    flow_wear,
)
from valvemap.model.kernels import flow_prior as prior
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.flow_basis import Axis, axis
from valvemap.model.samples import Floats

Counts = NDArray[np.int64]
Range = tuple[float, float]


@dataclass(frozen=True)
class FlowMapState(State):
    """What `FlowMap` knows; arrays of constant size, for n_U x n_s coefficients.

    Attributes
    ----------
    cells : (cells of U · cells of s, 10) float32
        See :mod:`kernels.flow_cells`.
    slopes : (61, 4) float32
        How the flow goes with s within some of them, see :mod:`kernels.flow_slopes`.
    begun : (2, 25) int32
        Cells of either side that a change may have come before, see :mod:`kernels.flow_begun`.
    theta : (n_U·n_s,) float32
        Coefficients of the map.
    std : (n_U·n_s,) float32
        Standard deviation of the smooth map at the sites, l/min.
    w, v : (n_U - 2,), (n_s - 2,) float64
        Local precisions of the prior along U and s.
    x, P, chance, now : (2, …)
        What moves in time, on either side of U = 0, see :mod:`kernels.flow_drift`.
    stay : (STAY,)
        The stay in a cell that lasts, see :mod:`kernels.flow_memory`.
    wear : (2, NODES + 1, COLUMNS)
        Wear of a part of an edge, on either side, see :mod:`kernels.flow_wear`.
    play : (PLACES,)
        Play between U and the spool, see :mod:`kernels.flow_play`.
    doubt : (n_U·n_s,) float32
        Standard deviation that the operators' parameters give the map at the sites, l/min.
    precision : (OF_MAP, OF_MAP) float32
        Inverse covariance of the operators' parameters, 0 of those that are not there.
    path : (PLACES,)
        Operators between map and samples, see :mod:`kernels.flow_path`.
    rivals : (PLACES, COLUMNS) float32
        Combinations of operators that are not in use, see :mod:`flow_rivals`.
    recent : (ROWS, COLUMNS) float32
        The last samples as measured, see the same.
    scalars, counters
        See :mod:`kernels.flow_fit` and :mod:`kernels.flow_memory`.
    """

    state_version: ClassVar[int] = 15  # 14: no evidence of former looks; 13: no noise of the timing

    cells: NDArray[np.float32]
    slopes: NDArray[np.float32]
    begun: NDArray[np.int32]
    theta: NDArray[np.float32]
    std: NDArray[np.float32]
    doubt: NDArray[np.float32]
    precision: NDArray[np.float32]
    w: Floats
    v: Floats
    x: Floats
    P: Floats
    chance: Floats
    now: Floats
    stay: Floats
    wear: Floats
    play: Floats
    path: Floats
    rivals: NDArray[np.float32]
    recent: NDArray[np.float32]
    scalars: Floats
    counters: Counts

    @classmethod
    def upgraded(cls, version: str, arrays: dict[str, Any]) -> dict[str, Any]:
        """Add what earlier versions did not know.

        Version 14: evidence for operators was that of one look; 13: noise did not depend on how
        fast the flow changes; 12: cells knew no slopes; 11: U had no noise; 10: that of Q was alike
        everywhere; 9: stays did not know signals on their way between two values; 8: cells did not
        know the oil's temperature, and offsets of sensors did not jump; 7: sensors had none; 6: no
        signal was held; 5: edges wore as a whole; 4: noise was AR(1), without a white part;
        3: nothing nameless was looked for.
        """
        number = int(version) if version.isdecimal() else 0
        if not 3 <= number <= 14:
            return {}
        arrays["rivals"] = flow_rivals.none()
        if number < 13:
            arrays["slopes"] = np.zeros((flow_slopes.PLACES, flow_slopes.COLUMNS), np.float32)
            arrays["begun"] = np.zeros((2, flow_begun.COLUMNS), np.int32)
        if number < 9:
            cls._add_former(version, arrays)
        if 7 <= number < 12:
            noise = flow_path.NOISE_U
            arrays["path"] = np.insert(arrays["path"], [noise, 2 * noise], 0.0)
        sizes = {"counters": flow_memory.COUNTERS, "scalars": flow_fit.SCALARS}
        for name, size in (sizes | {"stay": flow_memory.STAY}).items():
            arrays[name] = np.pad(arrays[name], (0, max(size - len(arrays[name]), 0)))
        return arrays

    @classmethod
    def _add_former(cls, version: str, arrays: dict[str, Any]) -> None:
        """Add what version 9 knew."""
        of_map = slice(flow_path.OF_MAP)
        arrays["precision"] = arrays["precision"][of_map, of_map].astype(np.float32)
        if version == "8":
            _add_jumps_of_offsets(arrays)
        else:
            cls._add_offsets(version, arrays)
        _add_oil(arrays)

    @staticmethod
    def _add_offsets(version: str, arrays: dict[str, Any]) -> None:
        """Add what version 8 knew, and jumps of offsets."""
        if version == "3":
            for name in ("x", "P"):
                still = arrays[name][:, flow_drift.STILL]
                arrays[name] = np.insert(arrays[name], 4, still, axis=1)
            arrays["chance"] = np.insert(arrays["chance"], 4, 0.0, axis=1)
        drift_states.upgrade(arrays)
        places, counters, scalars = flow_memory.BEFORE, arrays["counters"], arrays["scalars"]
        kind = counters[flow_memory.CHANGE_KIND]  # there were four named models, OTHER_GAIN was 2
        level, side = kind % 4 - 2, kind // 4
        counters[flow_memory.CHANGE_KIND] = (
            flow_drift.OTHER_GAIN + level + side * flow_drift.NAMED if kind else 0
        )
        stay = np.pad(arrays["stay"], (0, max(places + 4 - len(arrays["stay"]), 0)))
        arrays["stay"] = np.insert(stay[: places + 4], [places + 2] * 2 + [places + 4] * 2, 0.0)
        arrays["scalars"] = np.pad(scalars, (0, flow_fit.SCALARS - len(scalars)))
        if version == "7":
            return
        held, first = flow_path.PARAMETERS - flow_path.OF_MAP, flow_path.OF_MAP
        arrays["path"] = np.insert(arrays["path"], [first] * held + [2 * first] * held, 0.0)
        sizes = {"counters": flow_memory.COUNTERS, "scalars": flow_fit.SCALARS}
        for name, size in (sizes | {"path": flow_path.PLACES, "stay": flow_memory.STAY}).items():
            arrays[name] = np.pad(arrays[name][:size], (0, max(size - len(arrays[name]), 0)))
        arrays["scalars"][flow_fit.LEARNT_T] = arrays["scalars"][flow_fit.NOW_T]
        if version == "6":
            return
        arrays["wear"] = np.zeros((2, flow_wear.NODES + 1, flow_wear.COLUMNS))
        flow_wear.begin(arrays["wear"])
        arrays["recent"] = np.ascontiguousarray(arrays["recent"][:, : flow_path.COLUMNS])
        if version == "5":
            return
        scalars = arrays["scalars"]
        scalars[flow_fit.SLOW] = scalars[flow_fit.COLOUR] > 0.0
        scalars[flow_fit.AFTER] = scalars[flow_fit.COLOUR] * scalars[flow_fit.NEXT]
        scalars[flow_fit.AFTER_WEIGHT] = scalars[flow_fit.NEXT_WEIGHT]

    def contents(self) -> Mapping[str, Contents]:
        """What may stand in them."""
        every = slice(None)
        owners = every, flow_slopes.OWNER
        positive = [flow_cells.COUNT, flow_cells.WORTH, flow_cells.VAR_U, flow_cells.VAR_S]
        positive += [flow_cells.REFUSALS]
        scalars = Contents(self.scalars).within(0.0, where=slice(prior.FAMILIES + 3))
        of_oil = [flow_fit.FIRST_T, flow_fit.NOW_T, flow_fit.LEARNT_T]
        scalars.within(-1e9, 1e9, of_oil).or_nan(of_oil)
        likely = every, flow_wear.NODES, flow_wear.CHANCE
        columns = [flow_wear.P_LEVEL, flow_wear.P_RATE, flow_wear.GROWN, flow_wear.OWN]
        wearing = every, slice(flow_wear.NODES), columns
        counters = Contents(self.counters)
        times = [
            flow_memory.CLOCK,
            flow_memory.CLOCK + 1,
            flow_memory.STAY_TIME,
            flow_memory.CHANGE_TIME,
            flow_memory.LAST_TIME,
            flow_memory.WANDERED,
            flow_memory.PAIR_TIME,
            flow_memory.BEGAN_TIME,
        ]
        counters.any_time(times)
        flags = [flow_memory.FITTED, flow_memory.STAY_SIDE, flow_memory.SKIPPED]
        counters.within(0, 1, [*flags, flow_memory.ALARMED, flow_memory.BLOCKED])
        counters.within(0, flow_memory.A_GUESS, [flow_memory.DOUBTED])
        return {
            "cells": Contents(self.cells).within(0.0, where=(every, positive)),
            "slopes": Contents(self.slopes).within(0.0, len(self.cells), owners),
            "begun": Contents(self.begun).within(0, len(self.cells) - 1, (every, slice(1, None))),
            "std": Contents(self.std).within(0.0),
            "doubt": Contents(self.doubt).within(0.0),
            "precision": Contents(self.precision),
            "w": Contents(self.w).within(0.0),
            "v": Contents(self.v).within(0.0),
            "wear": Contents(self.wear).within(0.0, where=wearing).within(0.0, 1.0, likely),
            "chance": Contents(self.chance).within(0.0, 1.0),
            "path": Contents(self.path).within(0.0, where=slice(flow_path.GAINS)),
            "rivals": Contents(self.rivals).within(0.0),
            "recent": Contents(self.recent).within(0.0, where=(every, flow_path.STEP)),
            "scalars": scalars,
            "counters": counters,
        }


def _add_oil(arrays: dict[str, Any]) -> None:
    """Let cells of before hold flows of the first temperature, as they did.

    What leaks goes with ln ν and its bend in place of 1/ν - 1, to the first order the same.
    """
    cells, stay = arrays["cells"], arrays["stay"]
    together = 7  # U and s together, of which nothing is kept any more
    arrays["cells"] = np.pad(np.delete(cells, together, axis=1), ((0, 0), (0, 2)))
    arrays["theta"] = arrays["theta"].astype(np.float32)
    drift_states.by_logarithm(arrays)
    stay[: flow_memory.KNOWN_COUNT] = 0.0  # sums of other derivatives
    arrays["stay"] = np.pad(stay, (0, max(flow_memory.STAY - len(stay), 0)))
    more = flow_memory.COUNTERS - len(arrays["counters"])
    arrays["counters"] = np.pad(arrays["counters"], (0, more))
    arrays["scalars"][flow_fit.STAY_X : flow_fit.ALIKE + 1] = 0.0


def _add_jumps_of_offsets(arrays: dict[str, Any]) -> None:
    drift_states.add_jumps_of_offsets(arrays)
    counters = arrays["counters"]
    side, kind = divmod(counters[flow_memory.CHANGE_KIND], flow_drift.NAMED - 2)
    counters[flow_memory.CHANGE_KIND] = kind + side * flow_drift.NAMED


@lru_cache(maxsize=64)
def axes(U_range: Range, dp_range: Range) -> tuple[Axis, Axis]:
    """Axes of U and s for a valve of these ranges (%, bar)."""
    low, high = U_range
    parts = max(round((high - low) / rules.STEP_U), 4)
    shares = np.array(rules.SHARES_S)
    below, above = (np.sqrt(max(x, 0.0)) for x in (-dp_range[0], dp_range[1]))
    top = max(below, above)
    breaks = shares * top
    if below > rules.BEYOND * top:
        breaks = np.concatenate([-breaks[:0:-1], breaks])
    return axis(np.linspace(low, high, parts + 1)), axis(breaks)


def empty(axis_U: Axis, axis_s: Axis) -> FlowMapState:
    """State before the first sample."""
    n_U, n_s = len(axis_U.sites), len(axis_s.sites)
    cells = np.zeros(((n_U - 2) * (n_s - 2), flow_cells.COLUMNS), np.float32)
    counters = np.zeros(flow_memory.COUNTERS, np.int64)
    counters[flow_memory.NEXT_FIT] = rules.FIRST_FIT
    counters[flow_memory.NEXT_START] = rules.SECOND_START
    counters[flow_memory.NEXT_LOOK] = rules.LOOKS[0]
    state = FlowMapState(
        cells=cells,
        slopes=np.zeros((flow_slopes.PLACES, flow_slopes.COLUMNS), np.float32),
        begun=np.zeros((2, flow_begun.COLUMNS), np.int32),
        theta=np.zeros(n_U * n_s, np.float32),
        std=np.zeros(n_U * n_s, np.float32),
        doubt=np.zeros(n_U * n_s, np.float32),
        precision=np.zeros((flow_path.OF_MAP, flow_path.OF_MAP), np.float32),
        w=np.ones(n_U - 2),
        v=np.ones(n_s - 2),
        x=np.zeros((2, flow_drift.MODELS, flow_drift.STATES)),
        P=np.zeros((2, flow_drift.PACKED)),
        chance=np.zeros((2, flow_drift.MODELS)),
        now=np.zeros((2, 1 + flow_drift.SHOWN, flow_drift.SHOWN)),
        stay=np.zeros(flow_memory.STAY),
        wear=np.zeros((2, flow_wear.NODES + 1, flow_wear.COLUMNS)),
        play=np.zeros(flow_play.PLACES),
        path=np.zeros(flow_path.PLACES),
        rivals=flow_rivals.none(),
        recent=np.zeros((rules.ROWS, flow_path.COLUMNS), np.float32),
        scalars=np.zeros(flow_fit.SCALARS),
        counters=counters,
    )
    flow_drift.begin(state.x, state.P, state.chance, state.now)
    flow_wear.begin(state.wear)
    return state
