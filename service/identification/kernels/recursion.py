"""The recursion over samples: one call per batch, no allocation per sample.

``span`` is a chain of loops: ``warm_up`` in the information form until theta is determined, from
then on ``advance`` in the covariance form, with change detection between stretches. ``advance`` is
one flat loop on purpose: at n = 5 a call costs as much as the step. The rules that have something
to do before or after each step are in :mod:`service.identification.kernels.stepwise`.
"""

from typing import NamedTuple

import numpy as np

from service.identification.kernels.change_detection import (
    EVERY,
    FACTOR,
    SAMPLE,
    SIZE,
    Counts,
    has_changed,
)
from service.identification.kernels.compiled import inner, kernel
from service.identification.kernels.factors import (
    add_rank_one,
    back_substitute,
    covariance,
    independence,
    information_along,
    invert_triangle,
    is_estimable,
    project,
    rotate_in,
    scaled_trace,
)
from service.identification.samples import Codes, Floats, Status, Times

# Kinds of forgetting; up to RESETTING P is divided by λ.
EXPONENTIAL, VARIABLE, RESETTING, DIRECTIONAL, SUBSPACE, WINDOW = range(6)

# Places in `counters` and `noise`.
COUNT, FACTORED, HEAD, FILLED, STALE, OPENED = range(6)
PLACES_OF_COUNTERS = 6
WEIGHT, SQUARES, VARIANCE, TRACE = range(4)
PLACES_OF_NOISE = 4

LARGEST = 1e100  # a value beyond it cannot be squared and summed safely
TRACE_LIMIT = 1e10  # of P in units of the columns' scales: beyond it λ forgets along X alone
TRACE_EVERY = 16
FLOOR = 1e-4  # information along X, in squared scaled units, that forgetting leaves there
INDEPENDENT = 1e-3  # least independence of the regressors for which U·D·Uᵀ is as exact as R
OPENING = 10.0  # a changed plant: what was learnt before weighs a tenth of a sample
SETTLED = 20.0

_OK = int(Status.OK)
_WARMING_UP = int(Status.WARMING_UP)
_UNEXCITED = int(Status.UNEXCITED)
_REJECTED = int(Status.REJECTED)
_HELD = int(Status.HELD)


class Memory(NamedTuple):
    """The arrays of a state, see :class:`~service.identification.least_squares_state.RlsState`.

    The kernels write into them.
    """

    theta: Floats
    factor: Floats
    rhs: Floats
    spread: Floats
    scale: Floats
    noise: Floats
    counters: Counts
    window: Floats
    detector: Floats
    history: Counts
    score: Floats
    variance: Floats
    previous: Floats


class Rule(NamedTuple):
    """A rule of forgetting in numbers."""

    kind: int
    lam: float
    least: float = 1.0  # smallest λ; for RESETTING the information that is put back
    threshold: float = np.inf  # of change detection; infinite: none


class Batch(NamedTuple):
    """N samples and what becomes of them.

    t, X, y, usable : (N,), (N, n), (N,), (N,)
        Samples; where ``usable`` is 0 the state is not touched.
    predicted, residual, status : (N,)
        Written: the trace.
    thetas : (N, n) or (0, n)
        Written if it has rows: theta after each sample.
    changes : (C, 3)
        Written as far as it reaches: sample of the alarm, first sample after the change, mean
        innovation from there to the alarm.
    """

    t: Times
    X: Floats
    y: Floats
    usable: Codes
    predicted: Floats
    residual: Floats
    status: Codes
    thetas: Floats
    changes: Floats


@kernel
def run(memory: Memory, rule: Rule, batch: Batch) -> None:
    """Take N samples in, one after another; writes into ``memory`` and ``batch``."""
    theta, factor, rhs, spread, scale, noise, counters, _ = memory[:8]
    detector, history, score, variance, previous = memory[8:]
    t, X, y, usable, predicted, residual, status, thetas, changes = batch
    N = len(y)
    evidence = np.empty((N if rule.threshold < np.inf else 0, 3))
    span(
        theta, factor, rhs, spread, scale, noise, counters, detector, history, score, variance,
        previous, rule.kind, rule.lam, rule.least, rule.threshold, t, X, y, usable, predicted,
        residual, status, thetas, changes, evidence, np.empty((5, len(theta))), 0, N,
    )  # fmt: skip


@inner
def span(
    theta: Floats,
    factor: Floats,
    rhs: Floats,
    spread: Floats,
    scale: Floats,
    noise: Floats,
    counters: Counts,
    detector: Floats,
    history: Counts,
    score: Floats,
    variance: Floats,
    previous: Floats,
    kind: int,
    lam: float,
    least: float,
    threshold: float,
    t: Times,
    X: Floats,
    y: Floats,
    usable: Codes,
    predicted: Floats,
    residual: Floats,
    status: Codes,
    thetas: Floats,
    changes: Floats,
    evidence: Floats,
    work: Floats,
    start: int,
    end: int,
) -> None:
    """Samples start … end - 1 of one model."""
    found = 0
    first = end
    for i in range(start, end):
        if counters[FACTORED] == 1:
            first = i
            break
        warm_up(
            theta, factor, rhs, spread, scale, noise, counters, kind, lam,
            X, y, usable, predicted, residual, status, thetas, i,
        )  # fmt: skip
    while first < end:
        stop = end
        pace = lam
        if threshold < np.inf:
            stop = min(end, first + EVERY - counters[COUNT] % EVERY)
            pace = 1.0 - (1.0 - lam) * max(1.0, detector[FACTOR])
        advance(
            theta, factor, spread, scale, noise, counters, previous, kind, pace, least,
            X, y, usable, predicted, residual, status, thetas, evidence, work, first, stop,
        )  # fmt: skip
        if threshold < np.inf and has_changed(
            detector, history, score, variance, X, residual, evidence, t,
            lam, least, threshold, counters[COUNT], first, stop,
        ):  # fmt: skip
            _open(factor, spread, counters, lam)
            if found < len(changes):
                changes[found, 0] = stop - 1
                changes[found, 1] = stop - 1 - (counters[COUNT] - history[SAMPLE])
                changes[found, 2] = detector[SIZE]
            found += 1
        first = stop


@kernel
def evaluate(
    theta: Floats,
    factor: Floats,
    spread: Floats,
    scale: Floats,
    counters: Counts,
    X: Floats,
    values: Floats,
    variances: Floats,
) -> None:
    """Write Xᵀ·theta (N,) and, with theta's covariance, its variance (N,); NaN where unknown."""
    n = len(theta)
    factored = counters[FACTORED] == 1
    for i in range(len(X)):
        values[i] = np.nan
        variances[i] = np.nan
        if factored or is_estimable(factor, X, i, scale):
            total = 0.0
            for j in range(n):
                total += X[i, j] * theta[j]
            if np.isfinite(total):
                values[i] = total
        if np.isfinite(spread[0, 0]):
            total = 0.0
            for j in range(n):
                for k in range(n):
                    total += X[i, j] * spread[j, k] * X[i, k]
            if np.isfinite(total):
                variances[i] = max(total, 0.0)


@kernel
def determine(
    theta: Floats,
    factor: Floats,
    rhs: Floats,
    spread: Floats,
    scale: Floats,
    noise: Floats,
    counters: Counts,
    kind: int,
) -> bool:
    """Solve R·theta = z, and go over from R to U·D·Uᵀ once no digits are lost by that."""
    back_substitute(factor, rhs, theta)
    least = independence(factor)
    if least < (INDEPENDENT if kind <= RESETTING else 0.0) or least == 0.0:
        return least > 0.0
    n = len(theta)
    R = np.empty((n, n))
    for j in range(n):
        rhs[j] = 0.0
        for k in range(n):
            R[j, k] = factor[j, k]
    invert_triangle(R, factor)
    if kind > RESETTING:
        P = covariance(factor)
        for j in range(n):
            for k in range(n):
                spread[j, k] = P[j, k]
    noise[TRACE] = scaled_trace(factor, scale)
    counters[FACTORED] = 1
    return True


@inner
def warm_up(
    theta: Floats,
    R: Floats,
    rhs: Floats,
    spread: Floats,
    scale: Floats,
    noise: Floats,
    counters: Counts,
    kind: int,
    lam: float,
    X: Floats,
    y: Floats,
    usable: Codes,
    predicted: Floats,
    residual: Floats,
    status: Codes,
    thetas: Floats,
    i: int,
) -> None:
    """Sample i in the information form, from P₀ = ∞ until theta is determined: exact, eq. (16)."""
    n = len(theta)
    code = rejection(X, y, usable, i)
    predicted[i] = np.nan
    residual[i] = np.nan
    known = is_estimable(R, X, i, scale)
    if known:
        predicted[i] = 0.0
        for j in range(n):
            predicted[i] += X[i, j] * theta[j]
    if code == _OK:
        x = np.empty(n)
        if kind > RESETTING:
            lam = 1.0
        for j in range(n):
            x[j] = X[i, j]
            scale[j] = max(scale[j], abs(x[j]))
            if R[j, j] != 0.0 and (R[j, j] / scale[j]) ** 2 < 1.0 / TRACE_LIMIT:
                lam = 1.0
        if kind <= RESETTING:
            for j in range(n):
                for k in range(n):
                    spread[j, k] = lam * lam * spread[j, k] + x[j] * x[k]
        rest = rotate_in(R, rhs, x, y[i], lam, scale, counters[COUNT])
        if known:
            residual[i] = y[i] - predicted[i]
            noise[WEIGHT] = lam * noise[WEIGHT] + 1.0
            noise[SQUARES] = lam * lam * noise[SQUARES] + 1.0
            noise[VARIANCE] += (rest * rest - noise[VARIANCE]) / noise[WEIGHT]
        counters[COUNT] += 1
        determined = determine(theta, R, rhs, spread, scale, noise, counters, kind)
        code = _OK if determined else _WARMING_UP
    status[i] = code
    if i < len(thetas):
        for j in range(n):
            thetas[i, j] = theta[j]


@inner
def advance(
    theta: Floats,
    ut: Floats,
    spread: Floats,
    scale: Floats,
    noise: Floats,
    counters: Counts,
    previous: Floats,
    kind: int,
    lam: float,
    least: float,
    X: Floats,
    y: Floats,
    usable: Codes,
    predicted: Floats,
    residual: Floats,
    status: Codes,
    thetas: Floats,
    evidence: Floats,
    work: Floats,
    start: int,
    stop: int,
) -> None:
    """Samples start … stop - 1 in the covariance form U·D·Uᵀ; ``work`` (5, n) is scratch."""
    n = len(theta)
    x, f, Px, Sx, unit = work[0], work[1], work[2], work[3], work[4]
    for j in range(n):
        unit[j] = 1.0 / scale[j] if scale[j] > 0.0 else 0.0
    own_spread = kind > RESETTING
    divides = kind <= RESETTING
    along_x = kind == DIRECTIONAL and lam < 1.0
    for i in range(start, stop):
        # The innovation, and what P makes of X: f = Uᵀx, r = xᵀPx.
        within = abs(y[i]) <= LARGEST
        total = 0.0
        for j in range(n):
            x[j] = X[i, j]
            total += x[j] * theta[j]
            within &= abs(x[j]) <= LARGEST
        e = y[i] - total
        predicted[i] = total
        residual[i] = e
        r = 0.0
        for j in range(n):
            total = x[j]
            for k in range(j):
                total += ut[j, k] * x[k]
            f[j] = total
            r += total * total * ut[j, j]
        if not (within and usable[i] == 1 and r < LARGEST):
            code = rejection(X, y, usable, i)
            status[i] = _HELD if code == _OK else code
            residual[i] = np.nan
            if not np.isfinite(total):
                predicted[i] = np.nan
            if i < len(thetas):
                for j in range(n):
                    thetas[i, j] = theta[j]
            continue
        counters[COUNT] += 1
        for j in range(n):
            if abs(x[j]) > scale[j]:
                scale[j] = abs(x[j])
                unit[j] = 1.0 / scale[j]

        # What is forgotten: P ← (P - weight·PXXᵀP/(alpha + weight·r))/alpha.
        code = _OK if r > 0.0 else _UNEXCITED
        alpha, weight, held = 1.0, 1.0, False
        if divides:
            alpha = lam
            if kind == VARIABLE and noise[WEIGHT] > SETTLED and noise[VARIANCE] > 0.0:
                alpha = max(least, 1.0 - (1.0 - lam) * e * e / ((1.0 + r) * noise[VARIANCE]))
            due = (counters[COUNT] & (TRACE_EVERY - 1)) == 0 or noise[TRACE] > TRACE_LIMIT
            if due and lam < 1.0:
                held = _grows_beyond_limit(ut, scale, noise, f, Px, alpha, r)
                if held:
                    alpha, code = 1.0, _UNEXCITED
        if (along_x or held) and r > 0.0:  # Kulhavý: information is taken along X alone
            length = 0.0
            for j in range(n):
                length += (x[j] * unit[j]) ** 2
            if length > FLOOR * r:
                weight -= (1.0 - lam) / r
        elif kind == SUBSPACE and lam < 1.0:
            _forget_subspace(ut, x, unit, Px, Sx, lam)
            r = project(ut, x, f, Px)
        gain = 1.0 / (alpha + weight * r)

        # Bierman's recursion; Px becomes P·x with the P from before.
        growth = 1.0 / alpha
        for j in range(n):
            v = ut[j, j] * f[j]
            step = -weight * f[j] / alpha
            following = alpha + weight * f[j] * v
            ut[j, j] *= alpha / following * growth
            alpha = following
            for k in range(j):
                u = ut[j, k]
                ut[j, k] = u + step * Px[k]
                Px[k] += u * v
            Px[j] = v
        if len(evidence) > 0:
            moved = 0.0
            for j in range(n):
                moved += ((x[j] - previous[j]) * unit[j]) ** 2
                previous[j] = x[j]
            evidence[i, 0] = r
            evidence[i, 1] = moved

        # L = P(t)·X(t), eq. (23), and what the noise has made of theta.
        q = r
        if divides:
            if noise[WEIGHT] > 0.0:
                q = r * noise[SQUARES] / noise[WEIGHT]
            if held:
                turn_score(spread, x, Px, 1.0 - weight, 1.0)
            else:
                decay = growth**-2
                for j in range(n):
                    for k in range(n):
                        spread[j, k] = decay * spread[j, k] + x[j] * x[k]
        for j in range(n):
            Px[j] *= gain
            theta[j] += e * Px[j]
        if own_spread:
            q = 0.0
            for j in range(n):
                total = 0.0
                for k in range(n):
                    total += spread[j, k] * x[k]
                Sx[j] = total
                q += x[j] * total
            q = max(q, 0.0)
            for j in range(n):
                Sx[j] -= 0.5 * (1.0 + q) * Px[j]
            for j in range(n):
                for k in range(n):
                    spread[j, k] -= Px[j] * Sx[k] + Sx[j] * Px[k]
        if len(evidence) > 0:
            evidence[i, 2] = q
        noise[WEIGHT] = lam * noise[WEIGHT] + 1.0
        noise[SQUARES] = lam * lam * noise[SQUARES] + 1.0
        square = e * e / (1.0 + q)
        if kind == VARIABLE and noise[WEIGHT] > SETTLED:  # its own jumps must not raise σ²
            square = min(square, 9.0 * noise[VARIANCE])
        noise[VARIANCE] += (square - noise[VARIANCE]) / noise[WEIGHT]
        status[i] = code
        if i < len(thetas):
            for j in range(n):
                thetas[i, j] = theta[j]


@inner
def rejection(X: Floats, y: Floats, usable: Codes, i: int) -> int:
    """Why sample i cannot be used; OK if it can."""
    size = abs(y[i]) if np.isfinite(y[i]) else np.inf
    for j in range(X.shape[1]):
        size = max(size, abs(X[i, j])) if np.isfinite(X[i, j]) else np.inf
    if usable[i] == 0 or size == np.inf:
        return _REJECTED
    return _OK if size <= LARGEST else _HELD


@inner
def _grows_beyond_limit(
    ut: Floats, scale: Floats, noise: Floats, f: Floats, Px: Floats, lam: float, r: float
) -> bool:
    """Whether division by λ would add to a P that is beyond its limit already."""
    noise[TRACE] = scaled_trace(ut, scale)
    if noise[TRACE] <= TRACE_LIMIT:
        return False
    n = len(f)
    for j in range(n):
        v = ut[j, j] * f[j]
        Px[j] = v
        for k in range(j):
            Px[k] += ut[j, k] * v
    lost = 0.0
    for j in range(n):
        lost += (Px[j] * scale[j]) ** 2
    return bool((noise[TRACE] - lost / (lam + r)) / lam > noise[TRACE])


@inner
def _forget_subspace(ut: Floats, x: Floats, unit: Floats, v: Floats, w: Floats, lam: float) -> None:
    """P ← P + (1 - λ)/λ·vvᵀ/(vᵀP⁻¹v), v = X in the units of theta; ``v`` and ``w`` are scratch."""
    length = 0.0
    for j in range(len(x)):
        v[j] = x[j] * unit[j] * unit[j]
        length += v[j] * x[j]
    information = information_along(ut, v, w)
    if length > FLOOR and information > FLOOR * length:
        add_rank_one(ut, v, (1.0 - lam) / (lam * information))


@inner
def turn_score(Z: Floats, x: Floats, Px: Floats, taken: float, added: float) -> None:
    """Z ← B·Z·Bᵀ + added·xxᵀ with B = I - taken·x·(P·x)ᵀ: information was taken or put along x."""
    n = len(x)
    g = np.empty(n)
    total = 0.0
    for j in range(n):
        g[j] = 0.0
        for k in range(n):
            g[j] += Z[j, k] * Px[k]
        total += Px[j] * g[j]
    for j in range(n):
        for k in range(n):
            Z[j, k] += (added + taken * taken * total) * x[j] * x[k]
            Z[j, k] -= taken * (x[j] * g[k] + g[j] * x[k])


@inner
def _open(ut: Floats, spread: Floats, counters: Counts, lam: float) -> None:
    """Let theta go: what was learnt before the change weighs next to nothing from now on."""
    samples = float(counters[COUNT] - counters[OPENED])
    growth = OPENING * (min(1.0 / (1.0 - lam), samples) if lam < 1.0 else samples)
    counters[OPENED] = counters[COUNT]
    for j in range(len(ut)):
        ut[j, j] *= growth
        for k in range(len(ut)):
            spread[j, k] *= growth
