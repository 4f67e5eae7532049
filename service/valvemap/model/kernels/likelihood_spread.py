"""Variances of the recursion of maximum likelihood: P, and the covariance of theta for any gain."""

from valvemap.model.kernels import filtered_scores
from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.kernels.factors import project
from valvemap.model.kernels.likelihood_memory import (
    DETERMINED,
    VARIANCE,
    Memory,
    Scratch,
    dot,
    scratch_of,
)
from valvemap.model.samples import Floats


@kernel
def evaluate(memory: Memory, X: Floats, values: Floats, variances: Floats, shares: Floats) -> None:
    """Write Xᵀ·theta, its variance over σ², and that over the variance before any sample (N,)."""
    n, ns = len(memory.theta), X.shape[1]
    scratch = scratch_of(n)
    x = scratch.h
    held = _samples_held(memory, scratch)
    for t in range(len(X)):
        before = 0.0
        for j in range(ns):
            x[j] = X[t, j]
            before += memory.prior[j] * x[j] * x[j]
        r = project(memory.factor, x, scratch.f, scratch.Ph)
        values[t] = dot(x, memory.theta, ns)
        shares[t] = r / before if before > 0.0 else 0.0
        variances[t] = r
        if memory.monitor[DETERMINED] > 0.0:
            variances[t] = spread_along(memory.spread, x, scratch.Sh)
            variances[t] = _widened(memory, scratch.Ph, variances[t], held)


@kernel
def diagonals(fleet: Memory, P: Floats, inflations: Floats) -> None:
    """Write P's diagonals (M, n) of M models, arrays with a leading axis M, and `inflations`.

    The inflations (M, s) are the ratios of each parameter's variance to that in white noise.
    """
    scratch = scratch_of(fleet.theta.shape[1])
    for m in range(len(P)):
        memory = Memory(
            fleet.theta[m], fleet.factor[m], fleet.spread[m], fleet.prior[m],
            fleet.rls_theta[m], fleet.rls_factor[m], fleet.raw[m], fleet.filtered[m],
            fleet.monitor[m], fleet.early[m], fleet.omega[m], fleet.moments[m],
            fleet.blocks[m], fleet.colour[m],
        )  # fmt: skip
        held = _samples_held(memory, scratch)
        for j in range(P.shape[1]):
            _along_axis(memory, scratch, j)
            P[m, j] = scratch.Ph[j]
            own = memory.spread[j, j]
            if j >= inflations.shape[1]:
                continue
            wider = _widened(memory, scratch.Ph, own, held) / own if own > 0.0 else 1.0
            inflations[m, j] = wider


@inner
def spread_along(S: Floats, x: Floats, Sx: Floats) -> float:
    """Write S·x from the lower triangle of S; return xᵀ·S·x."""
    for j in range(len(x)):
        Sx[j] = S[j, j] * x[j]
        for i in range(j):
            Sx[j] += S[j, i] * x[i]
            Sx[i] += S[j, i] * x[j]
    return max(dot(x, Sx, len(x)), 0.0)


@inner
def update_spread(S: Floats, Px: Floats, Sx: Floats, gain: float, q: float) -> None:
    """Covariance of theta over σ²: S ← (I - L·hfᵀ)·S·(I - L·hfᵀ)ᵀ + L·Lᵀ, for any gain L."""
    c = gain * gain * (1.0 + q)
    for j in range(len(Px)):
        for i in range(j + 1):
            S[j, i] += c * Px[j] * Px[i] - gain * (Px[j] * Sx[i] + Sx[j] * Px[i])


@inner
def largest_share(memory: Memory, ns: int) -> float:
    """Largest variance of a parameter of the structure over that before any sample."""
    largest = 0.0
    for i in range(ns):
        largest = max(largest, variance_of(memory.factor, i) / memory.prior[i])
    return largest


@inner
def may_grow(factor: Floats, prior: Floats, lam: float) -> bool:
    """Whether P/λ stays below the prior; otherwise P is not divided, so that it is bounded."""
    if lam < 1.0:
        for i in range(len(factor)):
            if prior[i] > 0.0 and variance_of(factor, i) > lam * prior[i]:
                return False
    return True


@inner
def variance_of(factor: Floats, i: int) -> float:
    """P[i, i]."""
    total = float(factor[i, i])
    for j in range(i + 1, len(factor)):
        total += factor[j, j] * factor[j, i] * factor[j, i]
    return total


@inner
def _widened(memory: Memory, g: Floats, variance: float, held: float) -> float:
    """Variance over σ² along ``g`` = P·x with coloured noise, and with bias if ``held`` > 0."""
    noise = memory.monitor[VARIANCE]
    times = filtered_scores.inflation(memory.omega, memory.moments, memory.colour, g, noise)
    bias = held * filtered_scores.bias_along(memory.blocks, g) if held > 0.0 else 0.0
    return float(variance * times + (bias * bias / noise if noise > 0.0 else 0.0))


@inner
def _samples_held(memory: Memory, scratch: Scratch) -> float:
    """Effective number of samples in P, s over the trace of P·M; 0 unless regressors react."""
    if not filtered_scores.reacts(memory.blocks, memory.colour):
        return 0.0
    ns, trace = len(memory.rls_theta), 0.0
    for j in range(ns):
        _along_axis(memory, scratch, j)
        for k in range(ns):
            trace += scratch.Ph[k] * memory.moments[max(j, k), min(j, k)]
    return ns / trace if trace > 0.0 else 0.0


@inner
def _along_axis(memory: Memory, scratch: Scratch, j: int) -> None:
    """Write column j of P into ``scratch.Ph``."""
    for k in range(len(scratch.h)):
        scratch.h[k] = 1.0 if j == k else 0.0
    project(memory.factor, scratch.h, scratch.f, scratch.Ph)
