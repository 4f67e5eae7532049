"""The recursion over samples: one call per batch, no allocation per sample.

``run`` is a chain of loops: ``_warm_up`` in the information form until theta is determined, from
then on ``_advance`` in the covariance form, stretch by stretch where a rule of forgetting or change
detection has something to do in between. ``_advance`` is one flat loop without calls on purpose:
at n = 5 a call costs as much as the step.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from service.identification.kernels.change_detection import EVERY, SAMPLE, SIZE, Counts, has_changed
from service.identification.kernels.factors import (
    add_rank_one,
    back_substitute,
    covariance,
    information_along,
    invert_triangle,
    is_estimable,
    is_regular,
    project,
    rank_one,
    rotate_in,
    scaled_trace,
)
from service.identification.samples import Codes, Floats, Status, Times

# Kinds of forgetting; up to RESETTING P is divided by λ.
EXPONENTIAL, VARIABLE, RESETTING, DIRECTIONAL, SUBSPACE, WINDOW = range(6)

# Places in `counters` and `noise`.
COUNT, DETERMINED, HEAD, FILLED, STALE, OPENED = range(6)
PLACES_OF_COUNTERS = 6
WEIGHT, SQUARES, VARIANCE, TRACE = range(4)
PLACES_OF_NOISE = 4

LARGEST = 1e100  # a value beyond it cannot be squared and summed safely
TRACE_LIMIT = 1e10  # of P in units of the columns' scales: beyond it λ forgets along X alone
TRACE_EVERY = 16
FLOOR = 1e-4  # information along X, in squared scaled units, that forgetting leaves there
OPENING = 10.0  # a changed plant: what was learnt before weighs a tenth of a sample
SINGULAR = 1e-9  # share of the information along X that must be left when a sample is taken out
SETTLED = 20.0

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
    window: Floats
    detector: Floats
    history: Counts
    score: Floats
    previous: Floats


class Rule(NamedTuple):
    """A rule of forgetting in numbers."""

    kind: int
    lam: float
    least: float = 1.0  # smallest λ of VARIABLE; information put back by RESETTING
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


@njit(cache=True, error_model="numpy", nogil=True)
def run(memory: Memory, rule: Rule, batch: Batch) -> None:
    """Take N samples in, one after another; writes into ``memory`` and ``batch``."""
    counters, history = memory.counters, memory.history
    N = len(batch.y)
    detects = rule.threshold < np.inf
    evidence = np.empty((N, 3)) if detects else np.empty((0, 3))
    one_by_one = rule.kind in (RESETTING, SUBSPACE, WINDOW)
    found = 0
    i = _warm_up(memory, rule, batch)
    while i < N:
        stop = N
        if one_by_one:
            stop = i + 1
        elif detects:
            stop = min(N, i + EVERY - counters[COUNT] % EVERY)
        usable = _is_usable(batch, i)
        if usable and rule.kind == SUBSPACE:
            _forget_subspace(memory, batch.X[i], rule.lam)
        _advance(
            memory.theta, memory.factor, memory.spread, memory.scale, memory.noise, counters,
            memory.previous, rule.kind, rule.lam, rule.least, batch.X, batch.y, batch.usable,
            batch.predicted, batch.residual, batch.status, batch.thetas, evidence, i, stop,
        )  # fmt: skip
        if usable and rule.kind == RESETTING:
            _put_back(memory, counters[COUNT] % len(memory.theta), rule)
        elif usable and rule.kind == WINDOW:
            batch.status[i] = _slide(memory, batch.X[i], batch.y[i])
            if i < len(batch.thetas):
                batch.thetas[i] = memory.theta
        elif detects and has_changed(
            memory.detector, history, memory.score, memory.factor, batch.X, batch.residual,
            evidence, batch.t, rule.lam, rule.threshold, counters[COUNT], i, stop,
        ):  # fmt: skip
            _open(memory, rule.lam)
            if found < len(batch.changes):
                batch.changes[found, 0] = stop - 1
                batch.changes[found, 1] = stop - 1 - (counters[COUNT] - history[SAMPLE])
                batch.changes[found, 2] = memory.detector[SIZE]
            found += 1
        i = stop


@njit(cache=True, error_model="numpy", nogil=True)
def evaluate(memory: Memory, X: Floats, values: Floats, variances: Floats) -> None:
    """Write Xᵀ·theta (N,) and its variance over σ² (N,); NaN where unknown."""
    S, theta = memory.spread, memory.theta
    n = len(theta)
    work = np.empty(n)
    determined = memory.counters[DETERMINED] == 1
    for i in range(len(X)):
        values[i] = np.nan
        variances[i] = np.nan
        if determined or _is_fixed(memory, X[i], work):
            values[i] = 0.0
            for j in range(n):
                values[i] += X[i, j] * theta[j]
        if determined:
            total = 0.0
            for j in range(n):
                for k in range(n):
                    total += X[i, j] * S[j, k] * X[i, k]
            variances[i] = max(total, 0.0)


@njit(cache=True, error_model="numpy")
def determine(memory: Memory, rule: Rule) -> bool:
    """Solve R·theta = z; once the information is regular, go over from R to U·D·Uᵀ."""
    R, rhs, spread = memory.factor, memory.rhs, memory.spread
    n = len(R)
    back_substitute(R, rhs, memory.theta)
    if not is_regular(R):
        return False
    invert_triangle(R.copy(), R)
    P = covariance(R)
    for j in range(n):
        rhs[j] = 0.0
        for i in range(n):
            if rule.kind > RESETTING:
                spread[j, i] = P[j, i]
    memory.noise[TRACE] = scaled_trace(R, memory.scale)
    memory.counters[DETERMINED] = 1
    return True


@njit(cache=True, error_model="numpy")
def _warm_up(memory: Memory, rule: Rule, batch: Batch) -> int:
    """Information form from P₀ = ∞ until the samples determine theta, eq. (16): the next sample."""
    R, rhs, scale, noise = memory.factor, memory.rhs, memory.scale, memory.noise
    counters, theta, spread = memory.counters, memory.theta, memory.spread
    n = len(theta)
    x = np.empty(n)
    for i in range(len(batch.y)):
        if counters[DETERMINED] == 1:
            return i
        X = batch.X[i]
        y = batch.y[i]
        code = _rejection(X, y, batch.usable[i])
        batch.predicted[i] = np.nan
        batch.residual[i] = np.nan
        known = _size(X) <= LARGEST and _is_fixed(memory, X, x)
        if known:
            batch.predicted[i] = 0.0
            for j in range(n):
                batch.predicted[i] += X[j] * theta[j]
        if code == _OK:
            lam = rule.lam if rule.kind <= RESETTING else 1.0
            for j in range(n):
                x[j] = X[j]
                scale[j] = max(scale[j], abs(x[j]))
                if R[j, j] != 0.0 and (R[j, j] / scale[j]) ** 2 < 1.0 / TRACE_LIMIT:
                    lam = 1.0
            rest = rotate_in(R, rhs, x, y, lam, scale, counters[COUNT])
            if rule.kind <= RESETTING:
                for j in range(n):
                    for k in range(n):
                        spread[j, k] = lam * lam * spread[j, k] + X[j] * X[k]
            if known:
                batch.residual[i] = y - batch.predicted[i]
                noise[WEIGHT] = lam * noise[WEIGHT] + 1.0
                noise[SQUARES] = lam * lam * noise[SQUARES] + 1.0
                noise[VARIANCE] += (rest * rest - noise[VARIANCE]) / noise[WEIGHT]
            counters[COUNT] += 1
            if rule.kind == WINDOW and _push(memory, X, y):
                _factor_window(memory, R, rhs)
            code = _OK if determine(memory, rule) else _WARMING_UP
        batch.status[i] = code
        if i < len(batch.thetas):
            for j in range(n):
                batch.thetas[i, j] = theta[j]
    return len(batch.y)


@njit(cache=True, error_model="numpy")
def _advance(
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
    start: int,
    stop: int,
) -> None:
    """Samples start … stop - 1 in the covariance form U·D·Uᵀ."""
    n = len(theta)
    x, f, Px, Sx = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    unit = np.empty(n)
    for j in range(n):
        unit[j] = 1.0 / scale[j] if scale[j] > 0.0 else 0.0
    own_spread = kind in (DIRECTIONAL, SUBSPACE)
    divides = kind <= RESETTING
    along_x = kind == DIRECTIONAL and lam < 1.0
    for i in range(start, stop):
        # The innovation, and what P makes of X: f = Uᵀx, r = xᵀPx.
        e = y[i]
        within = abs(e) <= LARGEST
        for j in range(n):
            x[j] = X[i, j]
            e -= x[j] * theta[j]
            within &= abs(x[j]) <= LARGEST
        predicted[i] = y[i] - e
        residual[i] = e
        r = 0.0
        for j in range(n):
            total = x[j]
            for k in range(j):
                total += ut[j, k] * x[k]
            f[j] = total
            r += total * total * ut[j, j]
        if not (within and usable[i] == 1 and r < LARGEST):
            status[i] = _turn_away(theta, X, y, usable, predicted, residual, thetas, i)
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
            total = 0.0
            for j in range(n):
                total += Px[j] * previous[j]
                previous[j] = x[j]
            evidence[i, 0] = r
            evidence[i, 1] = total

        # L = P(t)·X(t), eq. (23), and what the noise has made of theta.
        q = r
        if divides:
            if noise[WEIGHT] > 0.0:
                q = r * noise[SQUARES] / noise[WEIGHT]
            if held:
                _turn_score(spread, x, Px, 1.0 - weight, 1.0)
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


@njit(cache=True, error_model="numpy")
def _turn_away(
    theta: Floats,
    X: Floats,
    y: Floats,
    usable: Codes,
    predicted: Floats,
    residual: Floats,
    thetas: Floats,
    i: int,
) -> int:
    """A sample that is not used: what can still be said of it, and why."""
    predicted[i] = np.nan
    residual[i] = np.nan
    if _size(X[i]) <= LARGEST:
        predicted[i] = 0.0
        for j in range(len(theta)):
            predicted[i] += X[i, j] * theta[j]
    if i < len(thetas):
        for j in range(len(theta)):
            thetas[i, j] = theta[j]
    code = _rejection(X[i], y[i], usable[i])
    return _HELD if code == _OK else code


@njit(cache=True, error_model="numpy")
def _is_usable(batch: Batch, i: int) -> bool:
    return _rejection(batch.X[i], batch.y[i], batch.usable[i]) == _OK


@njit(cache=True, error_model="numpy")
def _rejection(x: Floats, y: float, usable: int) -> int:
    size = _size(x)
    if usable == 0 or not (np.isfinite(y) and size < np.inf):
        return _REJECTED
    return _OK if size <= LARGEST and abs(y) <= LARGEST else _HELD


@njit(cache=True, error_model="numpy")
def _size(x: Floats) -> float:
    """Largest |x|, infinite if one is not finite."""
    size = 0.0
    for j in range(len(x)):
        size = max(size, abs(x[j])) if np.isfinite(x[j]) else np.inf
    return size


@njit(cache=True, error_model="numpy")
def _is_fixed(memory: Memory, x: Floats, work: Floats) -> bool:
    """Whether the samples so far fix Xᵀ·theta although not theta."""
    for j in range(len(x)):
        work[j] = x[j]
    return is_estimable(memory.factor, work, memory.scale)


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _turn_score(Z: Floats, x: Floats, Px: Floats, taken: float, added: float) -> None:
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


@njit(cache=True, error_model="numpy")
def _forget_subspace(memory: Memory, x: Floats, lam: float) -> None:
    """P ← P + (1 - λ)/λ·vvᵀ/(vᵀP⁻¹v), v = X in the units of theta."""
    ut, scale = memory.factor, memory.scale
    n = len(x)
    v, work = np.empty(n), np.empty(n)
    length = 0.0
    for j in range(n):
        v[j] = x[j] / scale[j] ** 2 if scale[j] > 0.0 else 0.0
        length += v[j] * x[j]
    information = information_along(ut, v, work)
    if length > FLOOR and information > FLOOR * length:
        add_rank_one(ut, v, (1.0 - lam) / (lam * information))


@njit(cache=True, error_model="numpy")
def _put_back(memory: Memory, j: int, rule: Rule) -> None:
    """Add information about parameter j; theta stays."""
    ut, scale = memory.factor, memory.scale
    n = len(ut)
    information = n * (1.0 - rule.lam) * rule.least * scale[j] ** 2
    f, Px, axis = np.empty(n), np.empty(n), np.zeros(n)
    axis[j] = 1.0
    project(ut, axis, f, Px)
    rank_one(ut, f, np.empty(n), 1.0, information, 1.0)
    _turn_score(memory.spread, axis, Px, -information, 0.0)


@njit(cache=True, error_model="numpy")
def _slide(memory: Memory, x: Floats, y: float) -> int:
    """Take the oldest sample of a full window out and put the new one in its place.

    A sample without which theta would not be determined stays.
    """
    theta, ut, window, counters = memory.theta, memory.factor, memory.window, memory.counters
    n = len(theta)
    if counters[FILLED] == len(window):
        f, Px = np.empty(n), np.empty(n)
        old = window[counters[HEAD]]
        r = project(ut, old[:n], f, Px)
        if r < 1.0 - SINGULAR:
            e = old[n]
            for j in range(n):
                e -= old[j] * theta[j]
            rank_one(ut, f, np.empty(n), 1.0, -1.0, 1.0)
            for j in range(n):
                theta[j] -= e / (1.0 - r) * Px[j]
        else:
            counters[STALE] = 1
    if _push(memory, x, y):  # once per turn, so that rounding cannot add up
        R, z = np.empty((n, n)), np.empty(n)
        _factor_window(memory, R, z)
        counters[STALE] = int(not is_regular(R))
        if counters[STALE] == 0:
            back_substitute(R, z, theta)
            invert_triangle(R, ut)
    return _UNEXCITED if counters[STALE] == 1 else _OK


@njit(cache=True, error_model="numpy")
def _push(memory: Memory, x: Floats, y: float) -> bool:
    """Write a sample into the window; True if that was its last place."""
    window, counters = memory.window, memory.counters
    row = window[counters[HEAD]]
    for j in range(len(x)):
        row[j] = x[j]
    row[len(x)] = y
    counters[HEAD] = (counters[HEAD] + 1) % len(window)
    counters[FILLED] = min(counters[FILLED] + 1, len(window))
    return bool(counters[HEAD] == 0)


@njit(cache=True, error_model="numpy")
def _factor_window(memory: Memory, R: Floats, z: Floats) -> None:
    """R and z of the samples in a full window."""
    window, n = memory.window, len(z)
    row = np.empty(n)
    for i in range(n):
        z[i] = 0.0
        for j in range(n):
            R[i, j] = 0.0
    for i in range(len(window)):
        for j in range(n):
            row[j] = window[i, j]
        rotate_in(R, z, row, window[i, n], 1.0, memory.scale, i)


@njit(cache=True, error_model="numpy")
def _open(memory: Memory, lam: float) -> None:
    """Let theta go: what was learnt before the change weighs next to nothing from now on."""
    ut, spread, counters = memory.factor, memory.spread, memory.counters
    samples = float(counters[COUNT] - counters[OPENED])
    growth = OPENING * (min(1.0 / (1.0 - lam), samples) if lam < 1.0 else samples)
    counters[OPENED] = counters[COUNT]
    for j in range(len(ut)):
        ut[j, j] *= growth
        for i in range(len(ut)):
            spread[j, i] *= growth
