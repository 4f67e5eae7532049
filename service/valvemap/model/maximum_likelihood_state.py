"""State of eq. (29), the call of its kernel, and quantities derived from it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from valvemap.model.contents import Contents
from valvemap.model.estimator import State
from valvemap.model.fleet import alone
from valvemap.model.flow_units import Powers, no_powers
from valvemap.model.kernels import likelihood_memory as memories
from valvemap.model.kernels import likelihood_spread, reaction
from valvemap.model.kernels import maximum_likelihood as kernel
from valvemap.model.kernels.factors import covariance
from valvemap.model.kernels.filtered_scores import (
    BEFORE,
    BLOCK_PRODUCT,
    BLOCK_SQUARE,
    BLOCKS,
    DOUBT,
    GATHERED,
    LAST,
    PLACES_OF_COLOUR,
    PRODUCT,
    REACTED,
    REACTING,
    ROWS_OF_BLOCKS,
    SCORE,
    SQUARE,
    THIS,
)
from valvemap.model.kernels.filtered_scores import REACTION as BLOCK_REACTION
from valvemap.model.samples import Codes, Floats, Segments


@dataclass(frozen=True)
class MaximumLikelihoodState(State):
    """State of eq. (29), for regressors scaled to magnitude 1.

    Attributes
    ----------
    theta : (n,)
        Parameters of the structure, then d.
    factor : (n, n)
        Uᵀ with D on its diagonal, P = U·D·Uᵀ.
    spread : (n, n)
        Lower triangle of the covariance of theta over σ²; unused until theta is determined.
    prior : (n,)
        Prior variances over σ²; 0 for d until σ² is known.
    rls_theta, rls_factor : (s,), (s, s)
        Plain RLS on the regressors without the noise columns.
    raw, filtered : (channels, lags)
        The last values of output, inputs and residual; the same through 1/D(q).
    monitor : (10,)
        Ramp, counts, noise variance and powers, see the kernel.
    early : (s,)
        The structure's parameters up to 31 samples ago; NaN at first.
    omega, moments, blocks, colour : (s, s), (s, s), (7, s), (18,)
        Statistics of coloured innovations, see
        :mod:`valvemap.model.kernels.filtered_scores`.
    """

    state_version: ClassVar[int] = 3  # 2: without the detection of reacting U and of drift

    theta: Floats
    factor: Floats
    spread: Floats
    prior: Floats
    rls_theta: Floats
    rls_factor: Floats
    raw: Floats
    filtered: Floats
    monitor: Floats
    early: Floats
    omega: Floats
    moments: Floats
    blocks: Floats
    colour: Floats

    def contents(self) -> Mapping[str, Contents]:
        """Valid values of the arrays."""
        reacts = [REACTING + place for place in (reaction.JITTERY, reaction.SEEN)]
        of_colour = [GATHERED, BLOCKS, SQUARE, BLOCK_SQUARE, *reacts]
        squares = ("factor", "spread", "rls_factor", "omega", "moments")
        return {
            **{name: _with_positive_diagonal(getattr(self, name)) for name in squares},
            "prior": Contents(self.prior).within(0.0),
            "monitor": Contents(self.monitor)
            .within(0.0)
            .within(0.0, 1.0, [memories.RAMP, memories.DETERMINED]),
            "early": Contents(self.early).or_nan(),
            "colour": Contents(self.colour).within(0.0, where=of_colour),
        }


def flow_powers(state: MaximumLikelihoodState) -> Powers:
    """Return the power of Q of each value of a static map's state.

    P is in units of σ², so that of the noise model, whose regressors are residuals, shrinks by Q².
    """
    n, ns = len(state.theta), len(state.rls_theta)
    found = no_powers(state)
    noise = (np.arange(n) >= ns).astype(np.int64)
    found["theta"][:ns] = found["rls_theta"][:] = found["early"][:] = 1
    found["factor"][:] = noise[:, None] - noise
    found["factor"][np.arange(n), np.arange(n)] = -2 * noise
    found["spread"][:] = -noise[:, None] - noise
    found["prior"][:] = -2 * noise
    for name in ("raw", "filtered"):
        found[name][[0, -1]] = 1  # output and residual
    found["monitor"][
        [memories.VARIANCE, memories.POWER, memories.RLS_POWER, memories.OUTPUT_POWER]
    ] = 2
    found["omega"][:] = 2
    found["blocks"][[THIS, BEFORE, BLOCK_REACTION, REACTED, SCORE]] = 1
    found["blocks"][DOUBT] = 2
    found["colour"][[PRODUCT, SQUARE, BLOCK_PRODUCT, BLOCK_SQUARE]] = 2
    found["colour"][[LAST, REACTING + reaction.LAST_E, REACTING + reaction.LAST_V]] = 1
    return found


def initial_state_of(orders: memories.Orders, p0: float) -> MaximumLikelihoodState:
    """Return theta = 0, P = p0·I for the structure's parameters."""
    n, nd = int(orders.sum()), int(orders[-1])
    ns = n - nd
    p0 = min(float(p0), memories.BOUNDLESS)
    unknown = max(p0, memories.OPEN)
    channels = (len(orders), max(1, int(orders.max())))
    monitor = np.zeros(memories.PLACES)
    monitor[memories.RAMP] = memories.RAMP_START if nd > 0 else 1.0
    return MaximumLikelihoodState(
        theta=np.zeros(n),
        factor=np.diag(np.append(np.full(ns, p0), np.zeros(nd))),
        spread=np.zeros((n, n)),
        prior=np.append(np.full(ns, unknown), np.zeros(nd)),
        rls_theta=np.zeros(ns),
        rls_factor=np.diag(np.full(ns, unknown)),
        raw=np.zeros(channels),
        filtered=np.zeros(channels),
        monitor=monitor,
        early=np.full(ns, np.nan),
        omega=np.zeros((ns, ns)),
        moments=np.zeros((ns, ns)),
        blocks=np.zeros((ROWS_OF_BLOCKS, ns)),
        colour=np.zeros(PLACES_OF_COLOUR),
    )


@dataclass(frozen=True)
class Run:
    """Results of a run over N samples.

    Attributes
    ----------
    predicted, posterior : (N,)
        hᵀ·theta before the update, y - hᵀ·theta after it.
    early : (N,)
        y minus the map, without the noise, of up to 31 samples before.
    share : (N,)
        Variance of the prediction over that before any sample.
    status : (N,)
        :class:`~valvemap.vocabulary.statuses.Status`.
    """

    predicted: Floats
    posterior: Floats
    early: Floats
    share: Floats
    status: Codes


def learn(
    states: MaximumLikelihoodState,
    rule: memories.Rule,
    orders: memories.Orders,
    X: Floats,
    U: Floats,
    y: Floats,
    segments: Segments,
    use: Codes | None = None,
    history: Floats | None = None,
) -> Run:
    """Run the kernel over N samples; the states' arrays, with a leading axis, are written in place.

    ``X`` (N, s), ``U`` (N,) and ``y`` (N,) hold the samples of many models by ``segments``. Where
    ``use`` (N,) is 0, theta is held. ``history`` (N, n), if given, receives theta after each
    sample.
    """
    N, n = len(y), states.theta.shape[1]
    values, status = np.empty((4, N)), np.empty(N, np.uint8)
    found = Run(values[0], values[1], values[2], values[3], status)
    kernel.run(
        memory_of(states),
        rule,
        orders,
        np.ascontiguousarray(X),
        U,
        np.ascontiguousarray(y),
        np.ones(N, np.uint8) if use is None else use,
        found.predicted,
        found.posterior,
        found.early,
        found.share,
        found.status,
        np.empty((0, n)) if history is None else history,
        segments,
        np.zeros((memories.SCRATCH, n)),
    )
    return found


def memory_of(state: MaximumLikelihoodState) -> memories.Memory:
    """The state's arrays for the kernel."""
    return memories.Memory(*(getattr(state, name) for name in memories.Memory._fields))


def noise_variance(state: MaximumLikelihoodState) -> float:
    """σ² of the innovation; NaN before the first sample."""
    return float(noise_variances(alone(state))[0])


def noise_variances(states: MaximumLikelihoodState) -> Floats:
    """σ² of the innovation of M models (M,); NaN before the first sample."""
    known = states.monitor[:, memories.WEIGHT] > 0
    return np.where(known, states.monitor[:, memories.VARIANCE], np.nan)


def parameter_covariance(state: MaximumLikelihoodState) -> Floats:
    """Covariance of theta (n, n), an upper bound until theta is determined."""
    over = covariance(state.factor)
    if state.monitor[memories.DETERMINED] > 0:
        over = mirrored(state.spread[None])[0]  # the upper triangle is unused
    with np.errstate(all="ignore"):
        return np.asarray(noise_variance(state) * over)


def diagonals(states: MaximumLikelihoodState) -> tuple[Floats, Floats]:
    """Return P's diagonals (M, n), and ratios of the variances to those in white noise (M, s)."""
    P, inflations = np.empty(states.theta.shape), np.empty(states.rls_theta.shape)
    likelihood_spread.diagonals(memory_of(states), P, inflations)
    return P, inflations


def mirrored(squares: Floats) -> Floats:
    """Return symmetric matrices (M, n, n) from their lower triangles."""
    return np.asarray(np.tril(squares) + np.tril(squares, -1).transpose(0, 2, 1))


def _with_positive_diagonal(square: Floats) -> Contents:
    places = np.arange(len(square))
    return Contents(square).within(0.0, where=(places, places))
