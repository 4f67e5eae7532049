"""Evidence for operators of `flow_path`: the residual of a coarse map of the last samples.

A map that is linear in its coefficients is filtered by a linear meter as its regressors are. So
for any parameters the best coarse map follows by least squares, and the residual is evidence.

What is left is white noise and a slow part, a first-order process (ARMA(1, 1): Harvey 1989), as in
`flow_noise`: with m its mean before a row and κ the gain of its filter in the steady state,

    r_i = m_i + v_i,    m_(i+1) = φ·(m_i + κ·v_i)

The innovations v are white, so their mean square is the likelihood, φ and κ being the likeliest.
φ = 1 is a level that wanders: an operator that only follows what wanders gains nothing.
"""

import math

import numpy as np

from valvemap.model.kernels import flow_between as between
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import Index, inner, kernel, maker
from valvemap.model.kernels.flow_basis import Axis
from valvemap.model.kernels.flow_regressors import filtered, regressors, row
from valvemap.model.samples import Floats, Singles


@kernel
def leftover(
    axis: Axis, top: float, rows: Floats, of_U: float, used: np.ndarray, given: Floats,
    ridge: float, in_phase: bool, b: Floats, residual: Floats, out: Floats,  # noqa: FBT001
) -> None:  # fmt: skip
    """Fill ``out`` (5,): mean square of the residual, number of rows, phase of friction.

    Then the variance of U's and Δp's noise that is averaged out, and the covariance of neighbours.
    ``in_phase``: friction holds the spool at U at first; else all `rules.PHASES` are tried.
    ``rows`` (N, paths.COLUMNS) in the order of time, ``of_U`` % noise of U in them; ``used`` (N,)
    see `counted`; ``given`` (PARAMETERS,); ``axis`` of a coarse map along U, ``top`` the largest
    √Δp. ``b`` (`terms_of`,) becomes the coarse map, drawn towards what it was by the weight of
    ``ridge`` samples; ``residual`` (N,) what it leaves, 0 at rows that do not count.
    """
    N, K = len(rows), len(b)
    t, base, work = np.zeros(N), np.zeros(N, np.int64), np.empty(3)
    prior, other, left, last = b.copy(), np.empty(K), np.empty(N), np.empty(5)
    out[0] = math.inf
    for phase in rules.PHASES:  # where friction held the spool at first is not known
        X, ways = np.zeros((N, K)), np.zeros((N, between.WAYS))
        regressors(axis, top, rows, of_U, given, phase, X, ways, t, base, work)
        X = filtered(X, rows, t, base, given)
        other[:], last[2] = prior, phase
        _fit(axis, X, ways, rows, used, given, ridge, other, left, last)
        if last[0] < out[0]:
            out[:], b[:], residual[:] = last, other, left
        if in_phase or given[paths.STICK] == 0.0:
            break


@kernel
def counted(rows: Floats, used: np.ndarray) -> None:
    """Mark the rows that count, (N,): those that no lag joins to a stretch without samples."""
    since = 0.0
    for i in range(len(rows)):
        step = rows[i, paths.STEP]
        since = 0.0 if i == 0 or step >= rules.GAP else since + step
        used[i] = since >= rules.LONGEST_LAG


@kernel
def as_they_were(rows: Floats, given: Floats, out: Floats) -> float:
    """Fill ``out``, a copy of the rows, with U and pressures as the parameters say they were.

    Return the noise that is left of U, %.
    """
    held_p, left = given[paths.HELD_P], 0.0
    for i in range(len(rows)):
        known, ahead = i + 1, len(rows) - 1 - i
        out[i, paths.LEFT_U], std = paths.commanded(rows, i, known, ahead, given)
        left += std * std if given[paths.NOISE_U] > 0.0 else 0.0
        out[i, paths.LEFT_DP] = paths.between(rows, i, known, ahead, paths.LEFT_DP, held_p)[0]
        out[i, paths.LEFT_P1] = paths.between(rows, i, known, ahead, paths.LEFT_P1, held_p)[0]
    return math.sqrt(left / max(len(rows), 1))


def terms_of(axis: Axis) -> int:
    """Number of coefficients of the coarse map."""
    return between.ALONG_S * len(axis.sites) + 2  # the last is that of U's news


@kernel
def refine(
    axis: Axis, top: float, b: Floats, axis_U: Axis, axis_s: Axis, theta: Floats | Singles
) -> None:  # fmt: skip
    """Fill the coefficients of the map with those of the coarse one, at their sites."""
    K, n_s = len(b), len(axis_s.sites)
    x, work = np.zeros(K), np.empty(3)
    for i in range(len(axis_U.sites)):
        u = min(max(axis_U.sites[i], axis.breaks[0]), axis.breaks[-1])
        for j in range(n_s):
            x[:] = 0.0
            row(axis, u, axis_s.sites[j] / top, x, work)
            total = 0.0
            for k in range(K):
                total += x[k] * b[k]
            theta[i * n_s + j] = total


@maker
def _fit(
    axis: Axis, X: Floats, ways: Floats, rows: Floats, used: np.ndarray, given: Floats,
    ridge: float, b: Floats, residual: Floats, out: Floats,
) -> None:  # fmt: skip
    N, K = X.shape
    prior = b.copy()
    top, least = given[paths.TOP], given[paths.LEAST]
    path = np.zeros(paths.PLACES)
    path[: paths.PARAMETERS] = given
    flows, limit, known = np.zeros(N), math.inf, 0
    scale, noise = np.ones(N), 0.0  # σ²/variance of a row; σ²
    averaged = np.zeros(N)
    settled = not ways[:, between.OFF_U :].any()
    has_ways = not settled
    residual[:] = 0.0
    first, refused = np.zeros(N, np.int64), np.zeros(N, np.bool_)
    for i in range(N):
        while X[i, first[i]] == 0.0 and first[i] < K - 1:
            first[i] += 1
    for k_round in range(rules.ROBUST_ROUNDS):
        A, x_Q = np.zeros(K * K), np.zeros(K)
        other, counted = 0, 0  # rows that are refused now and were not, or the other way round
        for i in range(N):
            Q, weight = rows[i, paths.LEFT_Q], scale[i]
            if not used[i]:
                continue
            if top > 0.0 and rules.NEAR_TOP * top < Q:  # tells something where it is contradicted
                if k_round == 0 or flows[i] >= top:
                    continue
                Q = top
            elif abs(Q) < rules.NEAR_LEAST * least:
                if k_round > 0 and abs(flows[i]) <= least:
                    continue
                weight = rules.FIRST_WEIGHT if k_round == 0 else 1.0
                Q = min(max(flows[i], -least), least)
            is_refused = abs(residual[i]) > limit
            other += is_refused != refused[i]
            refused[i] = is_refused
            if is_refused:
                continue
            counted += 1
            for k in range(first[i], K):
                x = weight * X[i, k]
                if x != 0.0:
                    x_Q[k] += x * Q
                    for j in range(first[i], k + 1):
                        A[Index(k * K + j)] += x * X[i, Index(j)]
        for k in range(K):
            A[k * K + k] += ridge
            x_Q[k] += ridge * prior[k]
        is_done = other == 0 and top + least == 0.0 and settled
        if counted <= K or (known > 0 and is_done):
            break
        b[:] = x_Q
        _solve(A.reshape((K, K)), b)
        known = 0
        for i in range(N):
            if used[i]:
                flow = 0.0
                for k in range(first[i], K):
                    flow += X[i, k] * b[k]
                flows[i], Q = flow, rows[i, paths.LEFT_Q]
                residual[i] = Q - paths.shown(flow, path)
                if abs(abs(flow) - least) < rules.NEAR_LEAST * least:
                    other = Q - flow if abs(flow) < least else Q
                    residual[i] = other if abs(other) < abs(residual[i]) else residual[i]
                known += 1
        if has_ways:
            noise, settled = between.weigh(axis, b, ways, used, noise, residual, scale, averaged)
        square = 0.0
        for i in range(N):
            square += residual[i] ** 2 if used[i] else 0.0
        limit = math.inf
        for _ in range(rules.ROBUST_STEPS):
            limit = rules.MOST_STAY * math.sqrt(square / max(known, 1))
            square = 0.0
            for i in range(N):
                if used[i]:
                    square += min(residual[i] ** 2, limit * limit)
    squares = 0.0
    for i in range(N):
        if used[i]:
            residual[i] = min(max(residual[i], -limit), limit)
            squares += residual[i] ** 2
    out[0], out[1] = squares / max(known, 1), max(known, 1)
    out[3:] = 0.0
    for i in range(N):
        out[3] += averaged[i] / max(known, 1)
        out[4] += averaged[i] * between.beside(ways[i, between.KEPT]) / max(known, 1)


@kernel
def colour(residual: Floats, used: np.ndarray, out: Floats) -> None:
    """Fill ``out`` (3,): mean square of the innovations, φ and κ, the likeliest."""
    work, many = np.empty(len(residual)), 0
    out[0] = math.inf
    for i in range(len(residual)):
        many += used[i]
    for phi in rules.SLOW_KEPT:
        for kappa in rules.SLOW_GAINS:
            square = _innovate(residual, used, phi, kappa, work) / max(many, 1)
            if square < out[0]:
                out[0], out[1], out[2] = square, phi, kappa


@kernel
def innovations(residual: Floats, used: np.ndarray, phi: float, kappa: float, out: Floats) -> None:
    """Fill ``out`` (N,) with a residual's innovations, 0 at rows that do not count."""
    out[:] = 0.0
    _innovate(residual, used, phi, kappa, out)


@inner
def _innovate(
    residual: Floats, used: np.ndarray, phi: float, kappa: float, out: Floats
) -> float:  # fmt: skip
    """Sum of the squares of the innovations, which ``out`` becomes where rows count."""
    slow = squares = 0.0
    for i in range(len(residual)):
        if used[i]:
            out[i] = residual[i] - slow
            slow = phi * (slow + kappa * out[i])
            squares += out[i] * out[i]
    return squares


@maker
def _solve(A: Floats, b: Floats) -> None:
    """Solve A·x = b in place by Cholesky's factor."""
    n = len(b)
    for i in range(n):
        for j in range(i):
            product = A[i, j]
            for k in range(j):
                product -= A[i, k] * A[j, k]
            A[i, j] = product / A[j, j]
        pivot, value = A[i, i], b[i]
        for k in range(i):
            pivot -= A[i, k] * A[i, k]
            value -= A[i, k] * b[k]
        A[i, i] = math.sqrt(max(pivot, 1e-12))
        b[i] = value / A[i, i]
    for i in range(n - 1, -1, -1):
        value = b[i]
        for k in range(i + 1, n):
            value -= A[k, i] * b[k]
        b[i] = value / A[i, i]
