"""Forgetting rules with operations before or after each step of the recursion."""

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel, maker
from valvemap.model.kernels.covariance_form import note
from valvemap.model.kernels.factors import back_substitute, independence, rotate_in
from valvemap.model.kernels.information_form import settle
from valvemap.model.kernels.recursion import Batch, Memory, run
from valvemap.model.kernels.row_layout import (
    COUNT,
    FACTORED,
    FILLED,
    HEAD,
    STALE,
    Counts,
    Places,
    Size,
    places_of,
)
from valvemap.model.kernels.rules import RESETTING, WINDOW, Rule, rejection
from valvemap.model.kernels.triangles import rotate, take_in, whiten
from valvemap.model.samples import Floats, Segments
from valvemap.vocabulary.statuses import Status

SINGULAR = 1e-9  # minimum share of the information along X after the removal of a sample

_OK = int(Status.OK)
_UNEXCITED = int(Status.UNEXCITED)


@kernel
def run_stepwise(size: Size, memory: Memory, rule: Rule, batch: Batch, segments: Segments) -> None:
    """As :func:`valvemap.model.kernels.recursion.run`, for RESETTING and WINDOW."""
    X, y, usable, status, thetas = batch.X, batch.y, batch.usable, batch.status, batch.thetas
    n = len(size)
    at = places_of(n)
    s = np.empty(at.end)
    one = Segments(np.empty(1, np.int64), np.empty(1, np.int64), np.empty(1, np.int64))
    for k in range(len(segments.members)):
        m = segments.members[k]
        row, R, rhs = memory.row[m], memory.R[m], memory.rhs[m]
        counters, window = memory.counters[m], memory.window[m]
        for i in range(segments.starts[k], segments.stops[k]):
            good = rejection(X, y, usable, i) == _OK
            warm = counters[FACTORED] == 0
            one.members[0], one.starts[0], one.stops[0] = m, i, i + 1
            run(size, memory, rule, batch, one)
            for p in range(at.x):
                s[p] = row[p]
            if good and rule.kind == RESETTING and not warm:
                share = n * (1.0 - rule.lam) * rule.least
                _put_back(size, s, at, counters[COUNT] % n, share)
            if good and rule.kind == WINDOW:
                if not warm and counters[FILLED] == len(window):
                    _take_out(size, s, at, window, counters)
                if _push(window, counters, X, y, i):
                    _factor_anew(s, R, rhs, window, counters)
                if counters[STALE] == 1:
                    status[i] = max(status[i], _UNEXCITED)
                note(s, at, thetas, i, n)
            for p in range(at.x):
                row[p] = s[p]


@inner
def _put_back(size: Size, s: Floats, at: Places, j: int, share: float) -> None:
    """Add information about parameter j, a share of a sample's; theta is not changed."""
    for k in range(len(size)):
        s[at.x + k] = 0.0
    s[at.x + j] = 1.0
    information = share * s[at.scale + j] ** 2
    whiten(size, s, at.factor, at.x, at.f)
    take_in(size, s, at.factor, at.f, at.Px, 1.0, information, 1.0)
    rotate(size, s, at.spread, at.x, at.Px, at.g, -information, 0.0)


@inner
def _take_out(size: Size, s: Floats, at: Places, window: Floats, counters: Counts) -> None:
    """Remove the window's oldest sample from P and theta, unless theta would be undetermined."""
    n = len(size)
    oldest = counters[HEAD]
    e = window[oldest, n]
    for j in range(n):
        s[at.x + j] = window[oldest, j]
        e -= s[at.x + j] * s[at.theta + j]
    r = whiten(size, s, at.factor, at.x, at.f)
    if r < 1.0 - SINGULAR:
        take_in(size, s, at.factor, at.f, at.Px, 1.0, -1.0, 1.0)
        for j in range(n):
            s[at.theta + j] -= e / (1.0 - r) * s[at.Px + j]
    else:
        counters[STALE] = 1


@inner
def _push(window: Floats, counters: Counts, X: Floats, y: Floats, i: int) -> bool:
    """Write a sample into the window; return True if that was its last place."""
    n = X.shape[1]
    for j in range(n):
        window[counters[HEAD], j] = X[i, j]
    window[counters[HEAD], n] = y[i]
    counters[HEAD] = (counters[HEAD] + 1) % len(window)
    counters[FILLED] = min(counters[FILLED] + 1, len(window))
    return bool(counters[HEAD] == 0)


@maker
def _factor_anew(s: Floats, R: Floats, rhs: Floats, window: Floats, counters: Counts) -> None:
    """Refactor the full window, once per turn, so that rounding errors do not accumulate."""
    n = len(rhs)
    at = places_of(n)
    scale, theta = s[at.scale : at.scale + n], s[at.theta : at.theta + n]
    fresh, z, row = np.zeros((n, n)), np.zeros(n), np.empty(n)
    for i in range(len(window)):
        for j in range(n):
            row[j] = window[i, j]
        rotate_in(fresh, z, row, window[i, n], 1.0, scale, i)
    regular = independence(fresh) > 0.0
    counters[STALE] = int(not regular)
    if counters[FACTORED] == 0:
        for j in range(n):
            rhs[j] = z[j]
            for k in range(n):
                R[j, k] = fresh[j, k]
    elif regular:
        settle(s, fresh)
    if regular or counters[FACTORED] == 0:
        back_substitute(fresh, z, theta)
