"""Lags between the signals: of U's effect on the valve, and of the meter that shows Q.

The valve opens by U behind a first-order lag, and Q is shown behind another:
``u' = (U - u) / LagU``, ``Q' = (f(u, s) - Q) / LagQ``. A map that is linear in its parameters lags
as its regressors do, so the residual over the lags tried finds them both.

The meter's lag is taken back: with S two equal first-order lags in a row, which change places with
the meter's, ``S·f = S·Q + LagQ·(S·Q)'`` whatever the map is, and the derivative is the difference
of S's two stages. A sample is learnt as S·f where S makes U and s be; what S makes of the map's
curvature beyond that is little, and the map says how much.
"""

import math

import numpy as np

from valvemap.model.kernels.compiled import Index, inner, kernel, lean_kernel
from valvemap.model.kernels.spline import basis
from valvemap.model.samples import Floats

# Places in this part of `scalars`.
LAG_U, LAG_Q, SHARE_Q, U_EFFECT, U_METERED, S_METERED, Q_METERED, RIVAL_METERED = range(8)
SINCE, FAMILIAR = 8, 9  # s since the signals began anew; share of known places along the lag
OFFSET = 10  # the map as the meter shows it less the map at what U and s lag to, l/min
SMOOTHING, SHARE_S = 11, 12  # of S: time constant of either stage, s; share of a step
U_FIRST, S_FIRST, Q_FIRST, MAP_FIRST = 13, 14, 15, 16  # after the first stage of S
U_SMOOTH, S_SMOOTH, Q_SMOOTH, MAP_SMOOTH = 17, 18, 19, 20  # after the second
CURVED = 21  # the map behind S less the map at what S makes of U and s, l/min
BEGAN_U, BEGAN_Q = 22, 23  # s: the lags that the map began with
KNOWN_LAGS = 24  # estimates of the lags, s, and the information behind them: see `lag_search`
SCALARS = KNOWN_LAGS + 6

# Places in this part of `counters`.
TIME, KEPT_TIME, KEPT_ROWS, LOOKED_FROM = 0, 1, 2, 3  # the last: kept when looks began anew
COUNTERS = 4

ROWS = 704  # samples that are looked at for lags: 7 s at 100 Hz, 11 kB
STEP, LEFT_U, LEFT_S, LEFT_Q = 0, 1, 2, 3  # columns: s since the row before, %, √bar, l/min
LEAST_STEP = 0.0079  # s: of faster signals not every sample is kept
NOISIER = 3.0  # variance of S·f over Q's: what S makes of the map's bends harms more than noise
NEWTONS = 30  # steps to the root of a cubic: each takes a third of what is left, then far more
GAP = 1.0  # s without samples: what lags starts anew
SETTLED = 4.0  # lags from a start until the signals belong together
FAST_U, FAST_S = 25.0, 4.0  # %, √bar behind S: faster samples are not learnt from
FAST_WHERE_NEW = 0.15  # ... and that share of it where the map is not known all along the lag
WELL_KNOWN = 0.95  # share of known places along the lag from which on it is
KNOTS = np.array([0.0] * 4 + [4.0, 10.0, 20.0, 40.0, 70.0] + [100.0] * 4)  # %: of a coarse map
RIDGE = 1e-4  # samples' weight that keeps a part of it without samples determined
TERMS = 2 * (len(KNOTS) - 4) + 1
LONGEST = 1.0  # s of a stretch that are left out, so that all lags tried are judged alike


@inner
def share(step: float, tau: float) -> float:
    """What of a step shows after ``step`` s behind a first-order lag ``tau``."""
    return 1.0 - math.exp(-step / tau) if tau > 0.0 else 1.0


@lean_kernel
def smoothing(step: float, lag_Q: float) -> float:
    """Time constant of S's stages, s: the shortest with which S·f is as noisy as that.

    White noise of variance 1 in Q is one of ``(1 + (lag_Q / x)²) / 4 · step / x`` in S·f.
    """
    if not lag_Q > 0.0:
        return 0.0
    x = max(lag_Q, step)  # from above the root, where Newton's steps go down to it
    for _ in range(NEWTONS):
        excess = 4.0 * NOISIER * x**3 - step * (x * x + lag_Q**2)
        x -= excess / (12.0 * NOISIER * x * x - 2.0 * step * x)
    return x


@inner
def follow(t: int, U: float, s: float, path: Floats, counters: np.ndarray) -> None:
    """Take U and s through the lags."""
    step = 1e-9 * (t - counters[TIME])
    counters[TIME] = t
    if not 0.0 < step < GAP or math.isnan(path[U_EFFECT]):
        path[U_EFFECT], path[U_METERED], path[S_METERED] = U, U, s
        path[U_FIRST], path[S_FIRST], path[U_SMOOTH], path[S_SMOOTH] = U, s, U, s
        path[Q_METERED] = path[RIVAL_METERED] = path[Q_FIRST] = path[MAP_FIRST] = math.nan
        path[SHARE_Q], path[SHARE_S], path[SINCE], path[FAMILIAR] = 1.0, 1.0, 0.0, 0.0
        return
    path[U_EFFECT] += share(step, path[LAG_U]) * (U - path[U_EFFECT])
    path[SHARE_Q] = share(step, path[LAG_Q])
    path[SHARE_S] = share(step, path[SMOOTHING])
    path[U_METERED] += path[SHARE_Q] * (path[U_EFFECT] - path[U_METERED])
    path[S_METERED] += path[SHARE_Q] * (s - path[S_METERED])
    _smooth(path[U_EFFECT], U_FIRST, U_SMOOTH, path)
    _smooth(s, S_FIRST, S_SMOOTH, path)
    path[SINCE] += step


@inner
def _smooth(x: float, first: int, second: int, path: Floats) -> None:
    """Take a signal through S."""
    if math.isnan(path[first]):
        path[first] = path[second] = x
    path[first] += path[SHARE_S] * (x - path[first])
    path[second] += path[SHARE_S] * (path[first] - path[second])


@inner
def uncover(Q: float, path: Floats) -> float:
    """S·f from what a meter that lags shows, sample by sample."""
    _smooth(Q, Q_FIRST, Q_SMOOTH, path)
    a, b = path[SHARE_Q], path[SHARE_S]
    if not (a > 0.0 and b < 1.0):
        return Q
    ahead = b * (1.0 - a) / (a * (1.0 - b))  # LagQ / SMOOTHING, for steps of any length
    uncovered: float = path[Q_SMOOTH] + ahead * (path[Q_FIRST] - path[Q_SMOOTH])
    return uncovered


@inner
def curved(mapped: float, there: float, path: Floats) -> None:
    """Know what S makes of a map beyond its value at what S makes of U and s."""
    if math.isnan(path[MAP_FIRST]):
        path[MAP_FIRST] = path[MAP_SMOOTH] = there
    _smooth(mapped, MAP_FIRST, MAP_SMOOTH, path)
    path[CURVED] = path[MAP_SMOOTH] - there


@inner
def belongs(s: float, weight: float, path: Floats) -> bool:
    """Whether a sample belongs to one place of the map, as far as the meter's lag is concerned.

    ``weight`` is that of the cell where U and s are. Where the map was known all along the lag, it
    says itself what the lag makes of it; otherwise U and s must not move far behind S.
    """
    slowest: float = max(path[LAG_U], path[LAG_Q])
    if slowest == 0.0:
        return True
    path[FAMILIAR] += path[SHARE_Q] * ((1.0 if weight >= 1.0 else 0.0) - path[FAMILIAR])
    fast = 1.0 if path[FAMILIAR] > WELL_KNOWN else FAST_WHERE_NEW
    near_U = abs(path[U_EFFECT] - path[U_SMOOTH]) <= fast * FAST_U
    near_s = abs(s - path[S_SMOOTH]) <= fast * FAST_S
    is_ready = path[LAG_Q] == 0.0 or path[SMOOTHING] > 0.0
    return bool(near_U and near_s and is_ready and path[SINCE] >= SETTLED * slowest)


@inner
def is_known(path: Floats) -> bool:
    """Whether the map was known all along the meter's lag."""
    return bool(path[LAG_Q] == 0.0 or path[FAMILIAR] > WELL_KNOWN)


@inner
def metered(Q: float, place: int, path: Floats) -> float:
    """Q as the meter shows it."""
    if math.isnan(path[place]):
        path[place] = Q
    path[place] += path[SHARE_Q] * (Q - path[place])
    shown: float = path[place]
    return shown


@inner
def keep(t: int, U: float, s: float, Q: float, recent: Floats, counters: np.ndarray) -> None:
    """Keep a sample among the last ROWS."""
    step = 1e-9 * (t - counters[KEPT_TIME])
    if 0.0 <= step < LEAST_STEP and counters[KEPT_ROWS] > 0:
        return
    row = recent[counters[KEPT_ROWS] % ROWS]
    row[STEP] = step if 0.0 < step < GAP else GAP
    row[LEFT_U], row[LEFT_S], row[LEFT_Q] = U, s, Q
    counters[KEPT_TIME] = t
    counters[KEPT_ROWS] += 1


@kernel
def misfit(rows: Floats, lag_U: float, lag_Q: float, rho: float) -> tuple[float, float]:
    """What a coarse map leaves of the rows kept, behind such lags: squares, (l/min)²; and rows.

    ``rows`` (N, 4) in the order of time; every other one counts. The map is a cubic spline in U
    times s and s², and a constant; a little ridge keeps it determined. Of each row, ``rho`` times
    the row before is taken off, as noise of such a correlation asks for.
    """
    information, rhs = np.zeros(TERMS * TERMS), np.zeros(TERMS)
    x, shown, scratch = np.zeros(TERMS), np.zeros(TERMS), np.empty((2, 4))
    white, before, Q_before = np.zeros(TERMS), np.zeros(TERMS), 0.0
    U, total, since, counted = 0.0, 0.0, 0.0, 0.0
    known, share_U, share_Q = -1.0, 1.0, 1.0
    for i in range(len(rows)):
        step = rows[i, STEP]
        fresh = i == 0 or step >= GAP
        if step != known:
            known, share_U, share_Q = step, share(step, lag_U), share(step, lag_Q)
        U = rows[i, LEFT_U] if fresh else U + share_U * (rows[i, LEFT_U] - U)
        _regressors(U, rows[i, LEFT_S], x, scratch)
        part = 1.0 if fresh else share_Q
        for k in range(TERMS):
            shown[k] += part * (x[k] - shown[k])
            white[k] = shown[k] - rho * before[k]
            before[k] = shown[k]
        since = 0.0 if fresh else since + step
        Q = rows[i, LEFT_Q] - rho * Q_before
        Q_before = rows[i, LEFT_Q]
        if since < LONGEST or i % 2:
            continue
        for k in range(TERMS):
            value = white[k]
            rhs[k] += value * Q
            for j in range(k + 1):  # `_explained` reads no more
                information[Index(k * TERMS + j)] += value * white[Index(j)]
        total += Q * Q
        counted += 2.0
    A = information.reshape((TERMS, TERMS))
    for k in range(TERMS):
        A[k, k] += RIDGE
    return 2.0 * (total - _explained(A, rhs)), counted


@inner
def _regressors(U: float, s: float, x: Floats, scratch: Floats) -> None:
    for k in range(TERMS):
        x[k] = 0.0
    root = s / 10.0
    first = basis(KNOTS, U, scratch[0], scratch[1])
    for k in range(4):
        x[2 * (first + k)] = scratch[0, k] * root
        x[2 * (first + k) + 1] = scratch[0, k] * root * root
    x[TERMS - 1] = 1.0


@inner
def _explained(A: Floats, b: Floats) -> float:
    """bᵀ·A⁻¹·b by Cholesky's factor, in place."""
    total = 0.0
    for i in range(len(b)):
        for j in range(i):
            product = A[i, j]
            for k in range(j):
                product -= A[i, k] * A[j, k]
            A[i, j] = product / A[j, j]
        pivot, value = A[i, i], b[i]
        for k in range(i):
            pivot -= A[i, k] * A[i, k]
            value -= A[i, k] * b[k]
        if not pivot > 0.0:
            return total
        A[i, i] = math.sqrt(pivot)
        b[i] = value / A[i, i]
        total += b[i] * b[i]
    return total
