"""Recursive maximum likelihood of lagged outputs and inputs, A·y = Σ B·u + D·v, eq. (29)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from valvemap.model.fleet import member, repeated
from valvemap.model.kernels import likelihood_memory as memories
from valvemap.model.kernels.stability import is_stable, root_margins
from valvemap.model.maximum_likelihood import check_settings
from valvemap.model.maximum_likelihood_state import initial_state_of, learn, parameter_covariance
from valvemap.model.samples import Codes, Floats, Segments


@dataclass(frozen=True)
class MaximumLikelihoodResult:
    """Result of `recursive_maximum_likelihood` for N samples.

    Attributes
    ----------
    theta : (n,)
        Final parameters a1 … , b1 … of each input, d1 …
    theta_history : (N, n)
        Parameters after each sample.
    innovations, residuals : (N,)
        ε = y - hᵀθ̂ before, v̂ = y - hᵀθ̂ after the update; NaN where y is missing.
    covariance : (n, n)
        Covariance of theta: the noise variance times P.
    root_margin : (N,)
        1 - max|root of D̂(q)| after each sample.
    status : (N,)
        :class:`~valvemap.vocabulary.statuses.Status`.
    restarts : int
        Number of restarts from plain RLS after a divergence.
    """

    theta: Floats
    theta_history: Floats
    innovations: Floats
    residuals: Floats
    covariance: Floats
    root_margin: Floats
    status: Codes
    restarts: int


def recursive_maximum_likelihood(
    y: ArrayLike,
    u: ArrayLike,
    na: int,
    nb: int | Sequence[int],
    nd: int,
    forgetting: float = 1.0,
    p0: float = 1e4,
    *,
    theta0: ArrayLike | None = None,
    radius: float = 0.995,
) -> MaximumLikelihoodResult:
    """Identify A(q)·y = Σ B_k(q)·u_k + D(q)·v recursively by maximum likelihood, eq. (29).

    A = 1 + a1·q⁻¹ + …, B_k = b1·q⁻¹ + … + b_nb·q⁻ⁿᵇ, D = 1 + d1·q⁻¹ + …; the algorithm is that of
    :class:`~valvemap.model.maximum_likelihood.MaximumLikelihood`.

    Parameters
    ----------
    y : (N,)
        Output; NaN is a missing sample, replaced by its prediction in the lagged values.
    u : (N,) or (N, m)
        Inputs; while the lagged values contain a missing one, theta is held.
    na, nb, nd : int
        Orders; ``nb`` may be a sequence, one order per input.
    forgetting : float
        λ of exponential forgetting, in (0, 1].
    p0 : float
        P(0) = p0·I for a and b, > 0, at most 1e20; for d it is 0.1 over the noise variance.
    theta0 : (n,), optional
        Initial parameters; an unstable D is contracted.
    radius : float
        The roots of D̂(q) stay inside it, in (0, 1).

    Raises
    ------
    ValueError
        if shapes or orders do not fit.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> u, v, y = rng.choice([-1.0, 1.0], 2000), rng.normal(size=2000), np.zeros(2000)
    >>> for t in range(1, 2000):
    ...     y[t] = 0.8 * y[t - 1] + u[t - 1] + v[t] + 0.5 * v[t - 1]
    >>> recursive_maximum_likelihood(y, u, na=1, nb=1, nd=1).theta.round(1)
    array([-0.8,  1. ,  0.5])
    """
    output = np.ascontiguousarray(y, np.float64)
    inputs = np.ascontiguousarray(u, np.float64)
    if inputs.ndim == 1:
        inputs = inputs[:, None]
    if output.ndim != 1 or inputs.ndim != 2 or len(inputs) != len(output):
        raise ValueError(f"y must be (N,) and u (N,) or (N, m), not {output.shape}, {np.shape(u)}")
    m = inputs.shape[1]
    lags = [nb] * m if isinstance(nb, int) else list(nb)
    if len(lags) != m:
        raise ValueError(f"nb has {len(lags)} orders for {m} inputs")
    orders = np.array([na, *lags, nd], np.int64)
    if (orders < 0).any() or orders.sum() == 0:
        raise ValueError(f"orders must be >= 0, and one > 0, not na={na}, nb={nb}, nd={nd}")
    check_settings(nd, forgetting, p0, radius)

    state = initial_state_of(orders, p0)
    n = len(state.theta)
    if theta0 is not None:
        start = np.array(theta0, np.float64)
        if start.shape != (n,) or not (np.abs(start) < memories.LARGEST).all():
            raise ValueError(f"theta0 must be {n} finite numbers, not {theta0!r}")
        start[n - nd :] = _contracted(start[n - nd :], radius)
        state = replace(state, theta=start)

    X, use = _delayed(inputs, max(lags, default=0))
    use &= np.isfinite(output)
    history = np.empty((len(output), n))
    rule = memories.Rule(memories.EXPONENTIAL, float(forgetting), float(radius))
    fleet, whole = repeated(state, 1), Segments.one(len(output))
    no_U = np.zeros(len(output))
    run = learn(fleet, rule, orders, X, no_U, output, whole, use.astype(np.uint8), history)
    state = member(fleet, 0)
    return MaximumLikelihoodResult(
        theta=state.theta,
        theta_history=history,
        innovations=output - run.predicted,
        residuals=run.posterior,
        covariance=parameter_covariance(state),
        root_margin=root_margins(np.ascontiguousarray(history[:, n - nd :])),
        status=run.status,
        restarts=int(state.monitor[memories.RESTARTS]),
    )


def _delayed(inputs: Floats, lags: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Rows u(t-1), gaps filled with the previous value; and a mask of rows without lagged gaps."""
    finite = np.isfinite(inputs)
    rows = np.where(finite, np.arange(len(inputs))[:, None], -1)
    rows = np.maximum.accumulate(rows, axis=0) if len(rows) else rows
    filled = np.where(rows >= 0, np.take_along_axis(inputs, np.maximum(rows, 0), axis=0), 0.0)
    delayed = np.zeros_like(inputs)
    delayed[1:] = filled[:-1]
    gaps = np.concatenate([np.zeros(1), np.cumsum(~finite.all(axis=1))])
    t = np.arange(len(inputs))
    return delayed, gaps[t] == gaps[np.maximum(t - lags, 0)]


def _contracted(d: Floats, radius: float) -> Floats:
    """Return D with its roots contracted until the largest is well within ``radius``."""
    if is_stable(d, radius):
        return d
    largest = 1.0 - root_margins(d[None, :])[0]
    result: Floats = d * (0.9 * radius / largest) ** np.arange(1, len(d) + 1)
    return result
