"""The recursion over samples: one call per batch, one step per sample, no allocation between."""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from service.identification.kernels.factors import (
    back_substitute,
    covariance,
    invert_triangle,
    is_estimable,
    is_regular,
    project,
    rank_one,
    rotate_in,
    scaled_trace,
)
from service.identification.samples import Codes, Floats, Status

Counts = NDArray[np.int64]

EXPONENTIAL = 0
DIRECTIONAL = 1

# Places in `counters` and `noise`.
COUNT, DETERMINED, PLACES_OF_COUNTERS = 0, 1, 2
WEIGHT, VARIANCE, TRACE, PLACES_OF_NOISE = 0, 1, 2, 3

LARGEST = 1e100  # a value beyond it cannot be squared and summed safely
TRACE_LIMIT = 1e10  # of P in units of the columns' scales: beyond it λ forgets along X alone
FLOOR = 1e-4  # information along X, in squared scaled units, that directional forgetting leaves

_OK = int(Status.OK)
_WARMING_UP = int(Status.WARMING_UP)
_UNEXCITED = int(Status.UNEXCITED)
_REJECTED = int(Status.REJECTED)
_HELD = int(Status.HELD)


class Memory(NamedTuple):
    """The arrays of a state, see :class:`~service.identification.recursive_least_squares.RlsState`.

    The kernels write into them.
    """

    theta: Floats
    factor: Floats
    rhs: Floats
    spread: Floats
    scale: Floats
    noise: Floats
    counters: Counts


class Rule(NamedTuple):
    """A rule of forgetting in numbers."""

    kind: int
    lam: float


class _Scratch(NamedTuple):
    """Vectors of one step, allocated once per batch."""

    x: Floats
    f: Floats
    Px: Floats
    Sx: Floats
    work: Floats


@njit(cache=True, error_model="numpy", nogil=True)
def run(
    memory: Memory,
    rule: Rule,
    X: Floats,
    y: Floats,
    usable: Codes,
    predicted: Floats,
    residual: Floats,
    status: Codes,
    history: Floats,
) -> None:
    """Take N samples in, one after another.

    Parameters
    ----------
    memory
        State, written in place.
    rule
        What is forgotten.
    X, y, usable : (N, n), (N,), (N,)
        Samples; where ``usable`` is 0 the state is not touched.
    predicted, residual, status : (N,)
        Written: the trace.
    history : (N, n) or (0, n)
        Written if it has rows: theta after each sample.
    """
    N, n = X.shape
    scratch = _Scratch(np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n))
    x = scratch.x
    for t in range(N):
        predicted[t] = np.nan
        residual[t] = np.nan
        largest = 0.0
        finite = True
        for j in range(n):
            x[j] = X[t, j]
            largest = max(largest, abs(x[j]))
            finite = finite and np.isfinite(x[j])
        if not finite:
            status[t] = _REJECTED
        elif largest > LARGEST:
            status[t] = _HELD
        else:
            determined = memory.counters[DETERMINED] == 1
            if determined or _is_fixed(memory, scratch):
                predicted[t] = _dot(x, memory.theta)
            e = y[t] - predicted[t]
            if not (usable[t] and np.isfinite(y[t])):
                status[t] = _REJECTED
            elif abs(y[t]) > LARGEST:
                status[t] = _HELD
            elif determined:
                status[t] = _step(memory, rule, scratch, e)
            else:
                status[t] = _warm_up(memory, rule, scratch, y[t], e)
            if status[t] != _REJECTED and status[t] != _HELD:
                residual[t] = e
        if t < len(history):
            for j in range(n):
                history[t, j] = memory.theta[j]


@njit(cache=True, error_model="numpy")
def determine(memory: Memory) -> bool:
    """Solve R·theta = z; once the information is regular, go over from R to U·D·Uᵀ."""
    R = memory.factor
    back_substitute(R, memory.rhs, memory.theta)
    if not is_regular(R):
        return False
    invert_triangle(R.copy(), memory.factor)
    memory.spread[:] = np.tril(covariance(memory.factor))
    memory.rhs[:] = 0.0
    memory.noise[TRACE] = scaled_trace(memory.factor, memory.scale)
    memory.counters[DETERMINED] = 1
    return True


@njit(cache=True, error_model="numpy", nogil=True)
def evaluate(memory: Memory, X: Floats, values: Floats, variances: Floats) -> None:
    """Write Xᵀ·theta (N,) and its variance over σ² (N,); NaN where unknown."""
    n = X.shape[1]
    scratch = _Scratch(np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n))
    determined = memory.counters[DETERMINED] == 1
    for t in range(len(X)):
        scratch.x[:] = X[t]
        known = determined or _is_fixed(memory, scratch)
        values[t] = _dot(X[t], memory.theta) if known else np.nan
        variances[t] = _spread_along(memory.spread, X[t], scratch.Sx) if determined else np.nan


@njit(cache=True, error_model="numpy")
def _is_fixed(memory: Memory, scratch: _Scratch) -> bool:
    """Whether the samples so far fix Xᵀ·theta although not theta."""
    scratch.work[:] = scratch.x
    return is_estimable(memory.factor, scratch.work, memory.scale)


@njit(cache=True, error_model="numpy")
def _warm_up(memory: Memory, rule: Rule, scratch: _Scratch, y: float, e: float) -> int:
    """Information form from P₀ = ∞ until the samples determine theta: exact, eq. (16)."""
    R, scale, noise, x = memory.factor, memory.scale, memory.noise, scratch.x
    smallest = np.inf
    for i in range(len(x)):
        scale[i] = max(scale[i], abs(x[i]))
        if R[i, i] != 0.0:
            smallest = min(smallest, abs(R[i, i]) / scale[i])
    exponential = rule.kind == EXPONENTIAL and smallest * smallest > 1.0 / TRACE_LIMIT
    lam = rule.lam if exponential else 1.0
    rest = rotate_in(R, memory.rhs, x, y, lam, scale, memory.counters[COUNT])
    if np.isfinite(e):
        noise[WEIGHT] = lam * noise[WEIGHT] + 1.0
        noise[VARIANCE] += (rest * rest - noise[VARIANCE]) / noise[WEIGHT]
    memory.counters[COUNT] += 1
    return _OK if determine(memory) else _WARMING_UP


@njit(cache=True, error_model="numpy")
def _step(memory: Memory, rule: Rule, scratch: _Scratch, e: float) -> int:
    """One sample in the covariance form U·D·Uᵀ, eq. (28)."""
    theta, ut, scale, noise = memory.theta, memory.factor, memory.scale, memory.noise
    x, f, Px, lam = scratch.x, scratch.f, scratch.Px, rule.lam
    n = len(x)
    r = project(ut, x, f, Px)
    if not (r < LARGEST and abs(e) < LARGEST):
        return _HELD
    for j in range(n):
        scale[j] = max(scale[j], abs(x[j]))
    memory.counters[COUNT] += 1

    status = _OK
    alpha, weight, growth = lam, 1.0, 1.0 / lam
    if lam < 1.0:
        along_x = rule.kind == DIRECTIONAL
        if rule.kind == EXPONENTIAL and _grows_beyond_limit(memory, scratch, lam, r):
            along_x = True
            status = _UNEXCITED
        if along_x:
            alpha, weight, growth = 1.0, _kulhavy(x, scale, lam, r), 1.0

    gain = 1.0 / (lam + r)
    q = r
    if rule.kind != EXPONENTIAL or lam < 1.0:
        q = _spread_along(memory.spread, x, scratch.Sx)
        _update_spread(memory.spread, Px, scratch.Sx, gain, q)
    noise[WEIGHT] = lam * noise[WEIGHT] + 1.0
    noise[VARIANCE] += (e * e / (1.0 + q) - noise[VARIANCE]) / noise[WEIGHT]
    rank_one(ut, f, scratch.work, alpha, weight, growth)
    for j in range(n):
        theta[j] += gain * e * Px[j]
    return status


@njit(cache=True, error_model="numpy")
def _kulhavy(x: Floats, scale: Floats, lam: float, r: float) -> float:
    """Information that the sample adds along X, less what is forgotten there."""
    length = 0.0
    for j in range(len(x)):
        if scale[j] > 0.0:
            length += (x[j] / scale[j]) ** 2
    if r <= 0.0 or length == 0.0:
        return 1.0
    return 1.0 - (1.0 - lam) * max(0.0, 1.0 / r - FLOOR / length)


@njit(cache=True, error_model="numpy")
def _grows_beyond_limit(memory: Memory, scratch: _Scratch, lam: float, r: float) -> bool:
    """Whether division by λ would add to a P that is beyond its limit already."""
    noise, n = memory.noise, len(memory.theta)
    if memory.counters[COUNT] % n == 0 or noise[TRACE] > TRACE_LIMIT:
        noise[TRACE] = scaled_trace(memory.factor, memory.scale)
    if noise[TRACE] <= TRACE_LIMIT:
        return False
    lost = 0.0
    for j in range(n):
        lost += (scratch.Px[j] * memory.scale[j]) ** 2
    return bool((noise[TRACE] - lost / (lam + r)) / lam > noise[TRACE])


@njit(cache=True, error_model="numpy")
def _dot(a: Floats, b: Floats) -> float:
    total = 0.0
    for j in range(len(a)):
        total += a[j] * b[j]
    return total


@njit(cache=True, error_model="numpy")
def _spread_along(S: Floats, x: Floats, Sx: Floats) -> float:
    """S·x from the lower triangle of S, and xᵀ·S·x."""
    for j in range(len(x)):
        Sx[j] = S[j, j] * x[j]
        for i in range(j):
            Sx[j] += S[j, i] * x[i]
            Sx[i] += S[j, i] * x[j]
    return max(_dot(x, Sx), 0.0)


@njit(cache=True, error_model="numpy")
def _update_spread(S: Floats, Px: Floats, Sx: Floats, gain: float, q: float) -> None:
    """Covariance of theta over σ²: S ← (I - L·Xᵀ)·S·(I - L·Xᵀ)ᵀ + L·Lᵀ, whatever the gain L."""
    c = gain * gain * (1.0 + q)
    for j in range(len(Px)):
        for i in range(j + 1):
            S[j, i] += c * Px[j] * Px[i] - gain * (Px[j] * Sx[i] + Sx[j] * Px[i])
