"""State of recursive least squares, and its operations on plain arrays."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, TypeVar, assert_never

import numpy as np

from valvemap.model.contents import Contents
from valvemap.model.estimator import State
from valvemap.model.flow_units import Powers, no_powers
from valvemap.model.forgetting import (
    Adaptive,
    Directional,
    Exponential,
    Forgetting,
    Resetting,
    SlidingWindow,
    Subspace,
    Variable,
)
from valvemap.model.kernels import reaction, rules, uncertainty
from valvemap.model.kernels.change_detection import SUSPICIOUS, value_of
from valvemap.model.kernels.factors import covariance, rotate_in
from valvemap.model.kernels.information_form import determine
from valvemap.model.kernels.places import (
    DEVIATION,
    FIELDS,
    FIELDS_OF_VISITS,
    KNOWN,
    LONGEST,
    NODES_A,
    NODES_B,
    PROVEN,
    SPREAD,
)
from valvemap.model.kernels.recursion import Batch, Memory, evaluate, run
from valvemap.model.kernels.row_layout import (
    BEND,
    BLOCK_PRODUCT,
    BLOCK_SQUARE,
    CARRIED,
    COMMON,
    FACTORED,
    FILLED,
    FLOOR,
    HASTE,
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
    SQUARES,
    STALE,
    SUM,
    SUSPECT_TIME,
    TIME,
    VARIANCE,
    VISIT_COMMON,
    VISIT_POWER,
    VISIT_SQUARES,
    VISIT_SUM,
    WEIGHT,
    Counts,
    Places,
    places,
    size_of,
)
from valvemap.model.kernels.rules import EVERY_NTH, RESETTING, Rule
from valvemap.model.kernels.stepwise import run_stepwise
from valvemap.model.place_grid import Grid, nowhere
from valvemap.model.samples import Codes, Flags, Floats, Segments, Singles, Times, Trace
from valvemap.vocabulary.statuses import Adaptation

A = TypeVar("A", Floats, Times, Codes)

NODES = NODES_A * NODES_B
BEHIND = 0.9  # factor on the common part of recent innovations: the bias of a map that drifts
EXACT = 1e-30  # relative to the largest pivot of P; smaller ones have no uncertainty
LEAST = 1e-150  # pivot of P if all have no uncertainty
REVISITS = 30.0  # visits of places before misfit can be judged
MISFITS = 0.25  # ratio of misfit to noise, mean squares, from which the structure does not fit


@dataclass(frozen=True)
class RlsState(State):
    """State of recursive least squares.

    Attributes
    ----------
    row : (size,)
        All values that a step reads and writes, in one array, see
        :mod:`valvemap.model.kernels.row_layout`. Triangles are lower, by rows.

        - theta (n,): parameters; 0 in directions that the samples do not determine.
        - scale (n,): largest |Xⱼ| so far; thresholds are in its units.
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
        """Largest |Xⱼ| so far (n,)."""
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


def predict(state: RlsState, X: Floats, forgetting: Forgetting) -> tuple[Floats, Floats]:
    """Xᵀ·theta (N,) at N rows of X and its standard deviation (N,); NaN if unknown."""
    values, variances = np.empty(len(X)), np.empty(len(X))
    evaluate(
        state.theta,
        state.R,
        parameter_covariance(state, forgetting),
        state.scale,
        state.counters,
        _writable(X),
        values,
        variances,
    )
    if _keeps(forgetting) and state.detector[HASTE] > PROVEN:
        variances += BEHIND * max(0.0, float(state.detector[PRODUCT]))
    return values, np.sqrt(variances)


def _keeps(forgetting: Forgetting) -> bool:
    """Whether a rule forgets nothing unless places drift."""
    return isinstance(forgetting, Adaptive) and forgetting.lam == 1.0


def adaptations(detectors: Floats, forgetting: Forgetting) -> Codes:
    """:class:`~valvemap.vocabulary.statuses.Adaptation` of M models from their detectors."""
    reacting = reaction.reacts(detectors, REACTION)
    if not _keeps(forgetting):
        return np.where(reacting, Adaptation.REACTING, Adaptation.UNDECIDED).astype(np.uint8)
    noise, seen = np.maximum(detectors[:, MISFIT_POWER], 0.0), detectors[:, REVISITED]
    misfit = (detectors[:, MISFIT] > MISFITS * noise) & (noise > 0.0)
    found = np.where(misfit, Adaptation.MISFIT, Adaptation.STEADY)
    new = detectors[:, NEW] > np.maximum(detectors[:, FLOOR], detectors[:, MISFIT])
    undecided = (seen < REVISITS) | (new & (detectors[:, NEW] > 0.0))
    found = np.where(undecided, Adaptation.UNDECIDED, found)
    found = np.where(detectors[:, HASTE] > PROVEN, Adaptation.DRIFT, found)
    return np.where(reacting, Adaptation.REACTING, found).astype(np.uint8)


def known_theta(state: RlsState) -> Floats:
    """Theta (n,), NaN where the samples do not determine it."""
    if is_determined(state):
        return state.theta.copy()
    n = len(state.rhs)
    values, unknown = np.empty(n), np.full((n, n), np.nan)
    known = _writable(state.theta), _writable(state.R), unknown, _writable(state.scale)
    evaluate(*known, state.counters, np.eye(n), values, np.empty(n))
    return values


def parameter_covariance(state: RlsState, forgetting: Forgetting) -> Floats:
    """Covariance of theta (n, n): noise from the innovations; NaN while not determined."""
    kind, scored = rule_of(forgetting, len(state.rhs)).kind, int(_keeps(forgetting))
    if state.counters[FACTORED] and state.noise[WEIGHT]:
        found = np.empty_like(state.R)
        uncertainty.parameter_covariance(_writable(state.row), kind, scored, found)
        return found
    P = matrix_P(state)
    if kind <= RESETTING and state.noise[WEIGHT] != state.noise[SQUARES]:
        P = P @ _symmetric(state.spread) @ P
    return np.asarray(P * _noise_variance(state))


def variances(fleet: RlsState, forgetting: Forgetting) -> tuple[Floats, Flags]:
    """Variance of each parameter of M models (M, n), and whether it is available (M,)."""
    known = np.empty(fleet.theta.shape)
    kind = rule_of(forgetting, fleet.rhs.shape[-1]).kind
    scored = int(_keeps(forgetting))
    uncertainty.parameter_variances(_writable(fleet.row), kind, scored, known)
    return known, (fleet.counters[:, FACTORED] == 1) & (fleet.noise[:, WEIGHT] > 0.0)


def parameter_variance(state: RlsState, forgetting: Forgetting) -> Floats:
    """Variance of each parameter (n,), as `variances`; NaN while not determined."""
    alone = RlsState(*(getattr(state, name)[None] for name in Memory._fields))
    known, is_known = variances(alone, forgetting)
    return known[0] if is_known[0] else np.diag(parameter_covariance(state, forgetting))


def matrix_P(state: RlsState) -> Floats:
    """P (n, n) of eqs. (17)-(28), the inverse information; NaN while theta is not determined."""
    if not is_determined(state):
        return np.full_like(state.R, np.nan)
    if state.counters[FACTORED]:
        return np.asarray(covariance(state.factor))
    inverse = np.linalg.inv(state.R)  # triangular: no pivoting
    return np.asarray(inverse @ inverse.T)


def information(state: RlsState) -> Floats:
    """P⁻¹ (n, n), the inverse of `matrix_P`; singular while theta is not determined."""
    if state.counters[FACTORED]:
        d = np.diag(state.factor)
        d = np.maximum(d, max(EXACT * d.max(), LEAST))
        V = np.tril(state.factor, -1) + np.eye(len(d))
        inverse = np.linalg.inv(V)  # with ones on the diagonal: P itself may be singular
        return np.asarray((inverse / d) @ inverse.T)
    return np.asarray(state.R.T @ state.R)


def is_determined(state: RlsState) -> bool:
    """Whether the samples determine theta."""
    return bool(state.counters[FACTORED]) or bool(np.diag(state.R).all())


def _noise_variance(state: RlsState) -> float:
    """σ² (NaN before the first innovation)."""
    return float(state.noise[VARIANCE]) if state.noise[WEIGHT] else np.nan


def learn(
    state: RlsState,
    forgetting: Forgetting,
    X: Floats,
    y: Floats,
    t: Times,
    usable: Codes,
    thetas: Floats | None = None,
    changes: Floats | None = None,
    grid: Grid | None = None,
) -> tuple[RlsState, Trace]:
    """Update with N samples in sequence.

    Parameters
    ----------
    state, forgetting
        Previous state; its forgetting rule.
    X, y, t, usable : (N, n), (N,), (N,), (N,)
        Regressors, output, times; samples with ``usable`` 0 do not change the state.
    thetas : (N, n), optional
        Written: theta after each sample.
    changes : (C, 3), optional
        Written: the first C detected changes, see `RlsResult`.
    grid : optional
        Places of the samples; without it, `Adaptive` has a single place.
    """
    after = RlsState(*(np.array(getattr(state, name))[None] for name in Memory._fields))
    batch = batch_of(X, y, t, usable, thetas, changes, grid)
    learn_segments(after, forgetting, batch, Segments.one(len(y)))
    trace = Trace(
        predicted=batch.predicted, residual=batch.residual, early=batch.early, status=batch.status
    )
    return RlsState(*(getattr(after, name)[0] for name in Memory._fields)), trace


def learn_segments(
    states: RlsState, forgetting: Forgetting, batch: Batch, segments: Segments
) -> None:
    """Update many models with their samples, in place; ``states`` have a leading axis."""
    n = states.rhs.shape[-1]
    size, rule = size_of(n), rule_of(forgetting, n)
    match forgetting:
        case Resetting() | SlidingWindow():
            run_stepwise(size, memory_of(states), rule, batch, segments)
        case _:
            run(size, memory_of(states), rule, batch, segments)


def batch_of(
    X: Floats,
    y: Floats,
    t: Times,
    usable: Codes,
    thetas: Floats | None = None,
    changes: Floats | None = None,
    grid: Grid | None = None,
) -> Batch:
    """Pack samples and output arrays for a kernel."""
    N, n = X.shape
    where = nowhere(n) if grid is None else grid
    return Batch(
        t=_writable(t),
        X=_writable(X),
        y=_writable(y),
        usable=_writable(usable),
        a=_writable(where.a),
        b=_writable(where.b),
        nodes=_writable(where.nodes),
        predicted=np.empty(N),
        residual=np.empty(N),
        early=np.empty(N),
        status=np.empty(N, np.uint8),
        thetas=np.empty((0, n)) if thetas is None else thetas,
        changes=np.empty((0, 3)) if changes is None else changes,
    )


_places_of = lru_cache(maxsize=64)(places)


def _writable(array: A) -> A:
    """Return the array or a copy: the kernel is compiled for plain writable arrays only."""
    return np.require(array, requirements=["C", "W", "A"])


def memory_of(state: RlsState) -> Memory:
    """The state's arrays for a kernel."""
    return Memory(*(getattr(state, name) for name in Memory._fields))


def _square(triangle: Floats, n: int) -> Floats:
    """Return the lower triangle (n, n) from its concatenated rows."""
    square = np.zeros((n, n))
    square[np.tril_indices(n)] = triangle
    return square


def _symmetric(lower: Floats) -> Floats:
    return np.asarray(lower + np.tril(lower, -1).T)


@lru_cache(maxsize=64)
def rule_of(forgetting: Forgetting, n: int) -> Rule:
    """Return the rule's numbers for n parameters."""
    match forgetting:
        case Exponential(lam):
            rule = Rule(rules.EXPONENTIAL, lam)
        case Variable(lam, least):
            rule = Rule(rules.VARIABLE, lam, least)
        case Resetting(lam, information):
            rule = Rule(rules.RESETTING, lam, information)
        case Directional(lam):
            rule = Rule(rules.DIRECTIONAL, lam)
        case Subspace(lam):
            rule = Rule(rules.SUBSPACE, lam)
        case SlidingWindow():
            rule = Rule(rules.WINDOW, forgetting.lam)
        case Adaptive(lam, least, threshold):
            slowest = 1.0 - lam if lam < 1.0 else 1.0 / LONGEST
            most = np.log(max(1.0, (1.0 - least) / slowest))
            limits = value_of(SUSPICIOUS, n), value_of(threshold, n)
            rule = Rule(rules.SUBSPACE, lam, least, *limits, EVERY_NTH, float(most))
        case _:
            assert_never(forgetting)
    return rule
