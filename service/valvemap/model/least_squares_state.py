"""State of recursive least squares."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, TypeVar

import numpy as np

from valvemap.model.contents import Contents
from valvemap.model.estimator import State
from valvemap.model.flow_units import Powers, no_powers
from valvemap.model.forgetting import (
    Adaptive,
    Forgetting,
    SlidingWindow,
)
from valvemap.model.forgetting_rules import rule_of
from valvemap.model.kernels import reaction
from valvemap.model.kernels.factors import rotate_in
from valvemap.model.kernels.information_form import determine
from valvemap.model.kernels.place_layout import (
    DEVIATION,
    FIELDS,
    FIELDS_OF_VISITS,
    KNOWN,
    NODES_A,
    NODES_B,
    SPREAD,
)
from valvemap.model.kernels.recursion import Memory
from valvemap.model.kernels.row_layout import (
    BEND,
    BLOCK_PRODUCT,
    BLOCK_SQUARE,
    CARRIED,
    COMMON,
    FACTORED,
    FILLED,
    FLOOR,
    HEAD,
    LAG,
    LAST_D,
    LAST_E,
    LAST_MEAN,
    LAST_SCORED,
    LOCAL,
    MISFIT,
    MISFIT_POWER,
    NEW,
    NODE,
    PLACES_OF_COUNTERS,
    PLACES_OF_NOISE,
    POWER,
    PRODUCT,
    REACTION,
    REVISITED,
    SCALE,
    SIZE,
    SQUARE,
    STALE,
    SUM,
    SUSPECT_TIME,
    TIME,
    VARIANCE,
    VISIT_COMMON,
    VISIT_POWER,
    VISIT_SQUARES,
    VISIT_SUM,
    Counts,
    Places,
    places,
)
from valvemap.model.kernels.rules import RESETTING
from valvemap.model.samples import Codes, Floats, Singles, Times

A = TypeVar("A", Floats, Times, Codes)

NODES = NODES_A * NODES_B


@dataclass(frozen=True)
class RlsState(State):
    """State of recursive least squares.

    Attributes
    ----------
    row : (size,)
        All values that a step reads and writes, in one array, see
        :mod:`valvemap.model.kernels.row_layout`. Triangles are lower, by rows.

        - theta (n,): parameters; 0 in directions that the samples do not determine.
        - scale (n,): largest |Xⱼ| of all samples; thresholds are in its units.
        - score (n,), variance (triangle), detector (65,): of change detection and of the memory
          of places, see :mod:`valvemap.model.kernels.change_detection`.
        - early (n,): parameters up to 31 samples ago; NaN at first.
        - factor (triangle): Uᵀ with D on its diagonal, P = U·D·Uᵀ, once theta is determined.
        - spread (triangle): covariance due to noise, over σ². With rules that divide P by λ, it is
          the covariance Z of P⁻¹·theta, and that of theta is P·Z·P. With the others, P⁻¹ and Z grow
          by the same X·Xᵀ, and it is their difference due to forgetting, P⁻¹ - Z.
        - noise (4,): sum of the weights and of their squares, estimate of σ², trace of P in units
          of the scales.
    R, rhs : (n, n), (n,)
        R·theta = z, RᵀR = P⁻¹, while theta is not determined or the regressors are nearly
        collinear; then unused.
    counters : (11,)
        Samples used; 1 with U·D·Uᵀ, 0 with R; place and fill of the window; 1 if P holds samples
        from before it; sample number at which the memory was last opened. Then number of changes,
        sample and time of the last one and of the suspected one.
    window : (length, n + 1)
        The last samples of a sliding window, X and y; no rows with other rules.
    flows : (nodes,), places : (nodes, 5), visits : (nodes, 2)
        Measurements by place, see :mod:`valvemap.model.kernels.places`; no rows with
        rules other than `Adaptive`.
    """

    state_version: ClassVar[int] = 5  # 4: without the time since the last visit of a place

    row: Floats
    R: Floats
    rhs: Floats
    counters: Counts
    window: Floats
    flows: Floats
    places: Singles
    visits: Codes

    def contents(self) -> Mapping[str, Contents]:
        """Valid values of the arrays; indices that kernels use are within bounds."""
        at, n = self._places, self.rhs.shape[-1]
        diagonal = np.arange(n) * (np.arange(n) + 3) // 2  # of a lower triangle, row by row
        row = Contents(self.row).within(0.0, where=slice(at.scale, at.score))
        row.or_nan(slice(at.early, at.block)).or_nan(slice(at.detector, at.x))
        row.or_nan(at.detector + NODE, allowed=False)  # an index
        for triangle in (at.factor, at.variance):
            row.within(0.0, where=triangle + diagonal)
        row.within(0.0, where=slice(at.noise, at.noise + PLACES_OF_NOISE))
        row.within(0.0, NODES - 1.0, at.detector + NODE)
        row.within(0.0, where=[at.detector + place for place in (FLOOR, REVISITED)])
        counters = Contents(self.counters).any_time([TIME, SUSPECT_TIME])
        counters.within(0, 1, [FACTORED, STALE]).within(0, len(self.window), FILLED)
        counters.within(0, max(len(self.window) - 1, 0), HEAD)
        flows = Contents(self.flows).or_nan()
        nodes = Contents(self.places).within(0.0, where=(slice(None), KNOWN)).or_nan()
        return {"row": row, "counters": counters, "flows": flows, "places": nodes}

    def is_coherent(self) -> bool:
        """Whether P and its inverse agree."""
        determined = not self.counters[FACTORED] or (np.diag(self.factor) > 0.0).all()
        return bool(determined)

    @property
    def theta(self) -> Floats:
        """Parameters (n,)."""
        return self.row[..., : self.rhs.shape[-1]]

    @property
    def scale(self) -> Floats:
        """Largest |Xⱼ| of all samples (n,)."""
        at = self._places
        return self.row[..., at.scale : at.score]

    @property
    def noise(self) -> Floats:
        """Sum of the weights, of their squares, σ², trace of P (4,)."""
        at = self._places
        return self.row[..., at.noise : at.detector]

    @property
    def detector(self) -> Floats:
        """State of change detection and of the memory of places (65,)."""
        at = self._places
        return self.row[..., at.detector : at.x]

    @property
    def factor(self) -> Floats:
        """Uᵀ with D on its diagonal (n, n)."""
        at = self._places
        return _square(self.row[at.factor : at.spread], self.rhs.shape[-1])

    @property
    def spread(self) -> Floats:
        """Lower triangle of the symmetric matrix (n, n)."""
        at = self._places
        return _square(self.row[at.spread : at.variance], self.rhs.shape[-1])

    @property
    def _places(self) -> Places:
        return _places_of(self.rhs.shape[-1])


def flow_powers(state: RlsState) -> Powers:
    """Return the power of Q of each value of a state; see `valvemap.model.flow_units`."""
    at, found = _places_of(len(state.rhs)), no_powers(state)
    row, detector = found["row"], found["row"][at.detector : at.x]
    row[at.theta : at.scale] = row[at.early : at.previous] = row[at.reaction : at.factor] = 1
    row[at.omega : at.moments] = row[at.doubt : at.noise] = row[at.noise + VARIANCE] = 2
    detector[_LINEAR], detector[_SQUARE] = 1, 2
    found["rhs"][:] = found["window"][:, -1:] = found["flows"][:] = 1
    found["places"][:, DEVIATION], found["places"][:, SPREAD] = 1, 2
    return found


_LINEAR = [SUM, SIZE, LAST_D, LAST_E, VISIT_SUM, LAST_MEAN, BEND, LAST_SCORED]
_LINEAR += [REACTION + reaction.LAST_E, REACTION + reaction.LAST_V]
_SQUARE = [FLOOR, POWER, LOCAL, VISIT_POWER, MISFIT, MISFIT_POWER, NEW, LAG]
_SQUARE += [VISIT_SQUARES, VISIT_COMMON, COMMON, CARRIED]
_SQUARE += [SCALE, PRODUCT, SQUARE, BLOCK_PRODUCT, BLOCK_SQUARE]


def initial_state(
    n: int,
    forgetting: Forgetting,
    p0: float = np.inf,
    prior: tuple[Floats, Floats] | None = None,
) -> RlsState:
    """Return the initial state of n parameters; ``prior``: rows (R, n) and values (R,)."""
    length = forgetting.length if isinstance(forgetting, SlidingWindow) else 0
    at, rule = places(n), rule_of(forgetting, n)
    nodes = NODES if isinstance(forgetting, Adaptive) else 0
    state = RlsState(
        row=np.zeros(at.x),
        R=np.eye(n) / np.sqrt(p0),
        rhs=np.zeros(n),
        counters=np.zeros(PLACES_OF_COUNTERS, np.int64),
        window=np.zeros((length, n + 1)),
        flows=np.zeros(nodes),
        places=np.zeros((nodes, FIELDS), np.float32),
        visits=np.zeros((nodes, FIELDS_OF_VISITS), np.uint8),
    )
    state.row[at.early : at.block] = np.nan
    Z = np.eye(n) / p0
    if prior is not None:
        rows, values = prior
        Z += rows.T @ rows
        np.max(np.abs(rows), axis=0, initial=0.0, out=state.scale)
        for i, (row, value) in enumerate(zip(rows, values, strict=True)):
            rotate_in(state.R, state.rhs, row.copy(), value, 1.0, state.scale, i)
    if rule.kind <= RESETTING:
        state.row[at.spread : at.variance] = Z[np.tril_indices(n)]
    determine(state.row, state.R, state.rhs, state.counters, rule.kind)
    return state


_places_of = lru_cache(maxsize=64)(places)


def writable(array: A) -> A:
    """Return the array or a copy: the kernel is compiled for plain writable arrays only."""
    return array if array.flags.carray else np.require(array, requirements=["C", "W", "A"])


def memory_of(state: RlsState) -> Memory:
    """The state's arrays for a kernel."""
    return Memory(*(getattr(state, name) for name in Memory._fields))


def _square(triangle: Floats, n: int) -> Floats:
    """Return the lower triangle (n, n) from its concatenated rows."""
    square = np.zeros((n, n))
    square[np.tril_indices(n)] = triangle
    return square
