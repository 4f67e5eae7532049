"""Rules of forgetting with something to do before or after each step of the recursion."""

import numpy as np

from service.identification.kernels.change_detection import Counts
from service.identification.kernels.compiled import inner, kernel
from service.identification.kernels.factors import (
    back_substitute,
    independence,
    invert_triangle,
    project,
    rank_one,
    rotate_in,
)
from service.identification.kernels.recursion import (
    COUNT,
    FACTORED,
    FILLED,
    HEAD,
    RESETTING,
    STALE,
    WINDOW,
    Batch,
    Memory,
    Rule,
    advance,
    rejection,
    turn_score,
    warm_up,
)
from service.identification.samples import Floats, Status

SINGULAR = 1e-9  # share of the information along X that must be left when a sample is taken out

_OK = int(Status.OK)
_UNEXCITED = int(Status.UNEXCITED)


@kernel
def run_stepwise(memory: Memory, rule: Rule, batch: Batch) -> None:
    """As :func:`service.identification.kernels.recursion.run`, for RESETTING and WINDOW."""
    theta, factor, rhs, spread, scale, noise, counters, window, _, _, _, _, previous = memory
    _, X, y, usable, predicted, residual, status, thetas, _ = batch
    n = len(theta)
    evidence, work = np.empty((0, 3)), np.empty((5, n))
    for i in range(len(y)):
        good = rejection(X, y, usable, i) == _OK
        warm = counters[FACTORED] == 0
        if warm:
            warm_up(
                theta, factor, rhs, spread, scale, noise, counters, rule.kind, rule.lam,
                X, y, usable, predicted, residual, status, thetas, i,
            )  # fmt: skip
        else:
            advance(
                theta, factor, spread, scale, noise, counters, previous, rule.kind, rule.lam,
                rule.least, X, y, usable, predicted, residual, status, thetas, evidence, work, i,
                i + 1,
            )  # fmt: skip
        if good and rule.kind == RESETTING and not warm:
            share = n * (1.0 - rule.lam) * rule.least
            _put_back(factor, spread, scale, counters[COUNT] % n, share)
        if good and rule.kind == WINDOW:
            if not warm and counters[FILLED] == len(window):
                _take_out(theta, factor, window, counters)
            if _push(window, counters, X, y, i):
                _factor_anew(theta, factor, rhs, scale, window, counters)
            if counters[STALE] == 1:
                status[i] = max(status[i], _UNEXCITED)
            if i < len(thetas):
                for j in range(n):
                    thetas[i, j] = theta[j]


@inner
def _put_back(ut: Floats, Z: Floats, scale: Floats, j: int, share: float) -> None:
    """Add information about parameter j, a share of a sample's; theta stays."""
    n = len(scale)
    f, Px, work, axis = np.empty(n), np.empty(n), np.empty(n), np.zeros(n)
    axis[j] = 1.0
    information = share * scale[j] ** 2
    project(ut, axis, f, Px)
    rank_one(ut, f, work, 1.0, information, 1.0)
    turn_score(Z, axis, Px, -information, 0.0)


@inner
def _take_out(theta: Floats, ut: Floats, window: Floats, counters: Counts) -> None:
    """Remove the window's oldest sample from P and theta, unless theta is open without it."""
    n = len(theta)
    x, f, Px, work = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    oldest = counters[HEAD]
    e = window[oldest, n]
    for j in range(n):
        x[j] = window[oldest, j]
        e -= x[j] * theta[j]
    r = project(ut, x, f, Px)
    if r < 1.0 - SINGULAR:
        rank_one(ut, f, work, 1.0, -1.0, 1.0)
        for j in range(n):
            theta[j] -= e / (1.0 - r) * Px[j]
    else:
        counters[STALE] = 1


@inner
def _push(window: Floats, counters: Counts, X: Floats, y: Floats, i: int) -> bool:
    """Write a sample into the window; True if that was its last place."""
    n = X.shape[1]
    for j in range(n):
        window[counters[HEAD], j] = X[i, j]
    window[counters[HEAD], n] = y[i]
    counters[HEAD] = (counters[HEAD] + 1) % len(window)
    counters[FILLED] = min(counters[FILLED] + 1, len(window))
    return bool(counters[HEAD] == 0)


@inner
def _factor_anew(
    theta: Floats, factor: Floats, rhs: Floats, scale: Floats, window: Floats, counters: Counts
) -> None:
    """Factor the full window, once per turn: rounding cannot add up."""
    n = len(theta)
    R, z, row = np.zeros((n, n)), np.zeros(n), np.empty(n)
    for i in range(len(window)):
        for j in range(n):
            row[j] = window[i, j]
        rotate_in(R, z, row, window[i, n], 1.0, scale, i)
    regular = independence(R) > 0.0
    counters[STALE] = int(not regular)
    if counters[FACTORED] == 0:
        for j in range(n):
            rhs[j] = z[j]
            for k in range(n):
                factor[j, k] = R[j, k]
    elif regular:
        invert_triangle(R, factor)
    if regular or counters[FACTORED] == 0:
        back_substitute(R, z, theta)
