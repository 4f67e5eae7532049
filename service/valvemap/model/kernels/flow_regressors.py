"""Regressors of the coarse map of `flow_evidence`: each sample's place behind the operators."""

import math

import numpy as np

from valvemap.model.kernels import flow_between as between
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner, maker
from valvemap.model.kernels.flow_basis import Axis, interval, values
from valvemap.model.samples import Floats


@maker
def regressors(
    axis: Axis, top: float, rows: Floats, of_U: float, given: Floats, phase: float, X: Floats,
    ways: Floats, t: Floats, base: np.ndarray, work: Floats,
) -> None:  # fmt: skip
    """Fill the regressors (N, K), and the places ``ways`` (N, between.WAYS) between two rows."""
    path = np.zeros(paths.PLACES)
    path[: paths.PARAMETERS], path[paths.PHASE] = given, phase
    low, high, p = axis.breaks[0], axis.breaks[-1], 0.0
    places, at, then = np.empty((len(rows), 2)), 0, 0  # spool and root; dead times ago
    usual = between.usual_bend(rows[:, paths.LEFT_U])
    steps = rows[:, paths.STEP]
    of_dp = between.noise_of(rows[:, paths.LEFT_DP], steps) / (top * top)
    if given[paths.NOISE_U] == 0.0:  # where U is never calm, its noise is known by its bends
        U = rows[:, paths.LEFT_U]
        of_U = max(min(of_U, between.noise_of(U, steps)), between.rounding_of(U, steps))
    for i in range(len(rows)):
        step = rows[i, paths.STEP]
        fresh = i == 0 or step >= rules.GAP
        t[i] = 0.0 if i == 0 else t[i - 1] + step
        base[i] = i if fresh else base[i - 1]
        U, kept = rows[i, paths.LEFT_U], between.kept_by_spool(step, of_U, given)
        if given[paths.DEAD_U] > 0.0:
            at, share = _before(t, at, base[i], i, given[paths.DEAD_U])
            U = rows[at, paths.LEFT_U]
            if share > 0.0:
                kept *= between.kept(share)
                U += share * (rows[at + 1, paths.LEFT_U] - U)
                ways[i, between.OFF_U] = between.bends(
                    rows[:, paths.LEFT_U], at, base[i], share, usual
                )
        ways[i, between.KEPT] = kept
        u = paths.spool(U, step, fresh, path)
        p = u if fresh else min(max(p, u - given[paths.PLAY]), u + given[paths.PLAY])
        places[i, 0] = min(max(p, low), high)
        places[i, 1] = paths.effective(rows[i, paths.LEFT_DP], rows[i, paths.LEFT_P1], path)
    usual, of_root = between.usual_bend(places[:, 0]), between.usual_bend(places[:, 1])
    is_filtered = paths.filters(path)  # a mean over several rows does not depend on one of them
    for i in range(len(rows)):
        u, s, kept = places[i, 0], places[i, 1], between.kept_by_meter(rows[i, paths.STEP], given)
        if given[paths.DEAD_Q] > 0.0:
            then, share = _before(t, then, base[i], i, given[paths.DEAD_Q])
            u, s = places[then, 0], places[then, 1]
            if share > 0.0:
                u += share * (places[then + 1, 0] - u)
                s = paths.root_between(s, places[then + 1, 1], share)
                kept *= between.kept(share)
                if not is_filtered:
                    ways[i, between.OFF_U] += between.bends(
                        places[:, 0], then, base[i], share, usual
                    )
                    ways[i, between.OFF_S] = (
                        between.bends(places[:, 1], then, base[i], share, of_root) / top
                    )
        ways[i, between.KEPT] *= kept
        ways[i, between.NOISE_U] = of_U * math.sqrt(1.0 - ways[i, between.KEPT])
        ways[i, between.NOISE_S] = (
            of_dp / (2.0 * max(abs(s) / top, rules.LAMINAR)) * math.sqrt(1.0 - kept)
        )
        ways[i, between.SPOOL], ways[i, between.SHARE] = u, s / top
        row(axis, u, s / top, X[i], work)
        if given[paths.NEWS] > 0.0 and given[paths.NOISE_U] > 0.0:
            X[i, len(X[i]) - 1] = rows[i, paths.MEASURED_U] - rows[i, paths.LEFT_U]
        elif given[paths.NEWS] > paths.PAST and 0 < i < len(rows) - 1:
            around = rows[i - 1, paths.MEASURED_U] + rows[i + 1, paths.MEASURED_U]
            X[i, len(X[i]) - 1] = rows[i, paths.MEASURED_U] - 0.5 * around
        elif given[paths.NEWS] > 0.0 and i >= base[i] + rules.BEFORE_NEWS:
            X[i, len(X[i]) - 1] = rows[i, paths.MEASURED_U] - _expected(rows, i)


@maker
def filtered(X: Floats, rows: Floats, t: Floats, base: np.ndarray, given: Floats) -> Floats:
    """Regressors as the meter shows them."""
    N, K = X.shape
    if given[paths.AVERAGE] > 0.0:
        mean, total, at, span = np.empty((N, K)), np.zeros(K), 0, 0.0
        for i in range(N):
            if base[i] == i:
                total[:], at, span = 0.0, i, 0.0
            step = t[i] - t[i - 1] if base[i] < i else 0.0
            for k in range(K):
                total[k] += step * X[i, k]
            span += step
            while at < i and span - (t[at + 1] - t[at]) >= given[paths.AVERAGE]:
                at += 1
                span -= t[at] - t[at - 1]
                for k in range(K):
                    total[k] -= (t[at] - t[at - 1]) * X[at, k]
            for k in range(K):  # the oldest row counts in part
                beyond = max(span - given[paths.AVERAGE], 0.0)
                oldest = X[min(at + 1, i), k]
                shown = (total[k] - beyond * oldest) / max(span - beyond, 1e-9)
                mean[i, k] = shown if abs(shown) >= rules.FADED else 0.0
            if span <= 0.0:
                mean[i] = X[i]
        X = mean
    if given[paths.LAG_Q] > 0.0:
        for i in range(N):
            if base[i] != i:
                keep = math.exp(-(t[i] - t[i - 1]) / given[paths.LAG_Q])
                for k in range(K):
                    X[i, k] += keep * (X[i - 1, k] - X[i, k])
                    if abs(X[i, k]) < rules.FADED:
                        X[i, k] = 0.0
    if given[paths.HELD_Q] > 0.0:
        for i in range(N):
            if base[i] != i and rows[i, paths.LEFT_Q] == rows[i - 1, paths.LEFT_Q]:
                X[i] = X[i - 1]
    return X


@inner
def row(axis: Axis, u: float, share: float, x: Floats, work: Floats) -> None:
    """Regressors of the coarse map at u and s = share·top; others stay 0."""
    k = interval(axis, u)
    values(axis, k, u, 0.0, work)
    for a in range(3):
        to = between.ALONG_S * (k + a)
        x[to] = work[a] * share
        x[to + 1] = work[a] * share * abs(share)
        x[to + 2] = work[a] * share / (abs(share) + rules.LAMINAR)
    x[between.ALONG_S * len(axis.sites)] = 1.0


@inner
def _before(t: Floats, at: int, base: int, i: int, dead: float) -> tuple[int, float]:
    """The last row, from ``at`` on, that is ``dead`` s older than row i, and the way to the next.

    The first of the stretch, ``base``, where none is so old.
    """
    at, then = max(at, base), t[i] - dead
    while at < i and t[at + 1] <= then:
        at += 1
    share = (then - t[at]) / (t[at + 1] - t[at]) if at < i else 0.0
    return at, max(share, 0.0)


@inner
def _expected(rows: Floats, i: int) -> float:
    """U of row i by the straight line through the rows before."""
    m, U = rules.BEFORE_NEWS, 0.0
    for j in range(1, m + 1):
        U += (2.0 * (2 * m + 1) - 6.0 * j) / (m * (m - 1)) * rows[i - j, paths.MEASURED_U]
    return U
