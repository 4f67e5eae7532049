"""Estimation of two lags, of U's effect and of the flow meter, by least squares.

A map that is linear in its parameters is filtered by the lags as its regressors are. For any pair
of lags, least squares therefore gives the best coarse map and its residual
(:func:`kernels.lag.misfit`), prewhitened for coloured noise. One search minimizes the score J over
the last N samples and estimates its curvature Λ. Searches are combined as information::

    J(x) = N·ln(squares) ~ (x - x̂)ᵀ·Λ·(x - x̂),   Σ = ΣΛ,   b = ΣΛ·x̂,   x = Σ⁻¹·b

A lag is accepted if J would be larger by CLEAR without it; a lag accepted before is kept while J
would be larger by STILL_CLEAR. This hysteresis is needed because J varies that much between
searches, and each change of the lags restarts the map.

x holds the *delays* of the samples, ``step / (exp(step / lag) - 1)``, see `delay`. The delay of a
slow lag is nearly the lag itself; that of a lag shorter than a step is nearly 0. As a function of
the lags, J is flat near 0 and steep beyond, so that a parabola in them would accept lags without
evidence.
"""

import math
from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Final

import numpy as np

from valvemap.model import jitter
from valvemap.model.kernels import lag as kernel
from valvemap.model.samples import Floats

TRIED_U: Final = (0.0, 0.03, 0.1)  # s
TRIED_Q: Final = (0.0, 0.03, 0.08, 0.2, 0.45)  # s
MOST: Final = 0.6  # s: upper bound of the search
LEAST: Final = 0.010  # s: a shorter delay is taken as 0; one sample at 100 Hz
FIRST_STEP: Final = 0.3  # first step relative to the lag, at least LEAST_STEP
LEAST_STEP: Final = 0.006  # s
ROUNDS: Final = 6  # coordinate steps, halvings included
NEWTONS: Final = 12  # Newton steps afterwards
SHARES: Final = (1.0, 0.4, 0.1)  # step lengths tried of a Newton step
NEAR: Final = 0.004  # s: step of the finite differences
LEAST_BEND: Final = 1.0  # 1/s²: curvature used where J is not convex
LEAST_GAIN: Final = 0.5  # in J: stop if a step gains less
LEAST_WAY: Final = 0.3, 1.0  # ranges that U and Q must travel for their lags to be identifiable
PERCENT_OF_S: Final = 7.0  # % of U per √bar: 100 % correspond to 14 √bar
MOST_STEPS: Final = 500.0  # steps: a lag with a smaller exponential is immediate
SPARSE: Final = 20  # rows; the travel is measured over every 20th row to suppress noise
LEAST_ROWS: Final = 200  # rows with weight that a search needs: 2 s at 100 Hz
CLEAR: Final = 40.0  # gain in J from which a lag is accepted
STILL_CLEAR: Final = 10.0  # gain in J from which it is kept; noise alone gains 1, rarely 10
WORTH_OF_JITTERY: Final = 0.2  # weight of a search with jitter; at standstill, jitter gains 120
COLOURS: Final = (0.0, 0.3, 0.6, 0.8, 0.9, 0.95, 0.98)  # lag-1 correlations tried
KEPT: Final = 0.9  # share of the information kept at each search, since lags may change
LOOKED, UU, UQ, QQ, B_U, B_Q = range(6)  # indices of `known`

Pair = tuple[float, float]  # lag of U's effect and of the meter, s
NO_LAGS: Final = (0.0, 0.0)  # s


def look(
    rows: Floats,
    known: Floats,
    given: tuple[float | None, float | None],
    before: Pair = NO_LAGS,
    *,
    doubted: bool = False,
) -> Pair:
    """Update the lags from ``rows``, see :func:`kernels.lag.keep`; writes ``known`` (6,).

    The first search is global, later ones start at the known lags. With ``doubted``, the search is
    global again; if these rows clearly contradict the lags ``before``, their information is
    replaced, otherwise it is kept. Jitter of U and s is removed first: a lag would smooth it and
    seem to explain the flow better. With jitter, a search has less weight.
    """
    rows, is_jittery = _calmed(rows)
    worth = WORTH_OF_JITTERY if is_jittery else 1.0
    step = _usual_step(rows)
    squares, counted = kernel.misfit(rows, 0.0, 0.0, 0.0)
    if counted >= LEAST_ROWS and squares > 0.0:

        def score(delays: Pair, rho: float) -> float:
            left = kernel.misfit(rows, *_lags(delays, step), rho)[0]
            return worth * float(counted * math.log(max(left, 1e-12 * squares)))

        near = _resolved(known) if known[LOOKED] and not doubted else None
        ways = _moved(rows, kernel.LEFT_U), _moved(rows, kernel.LEFT_Q)
        free = ways[0] >= LEAST_WAY[0], ways[1] >= LEAST_WAY[1]
        at = _search(partial(score, rho=0.0), near, free)
        rho = min(COLOURS, key=lambda rho: score(at, rho))
        if rho:
            at = _search(partial(score, rho=rho), near, free)
        found = _bowl(partial(score, rho=rho), at, free)
        if found is not None:
            _claim_no_more(found, partial(score, rho=rho), at, free)
        if found is not None and doubted:
            believed = delay(before[0], step), delay(before[1], step)
            if score(believed, rho) - score(at, rho) > CLEAR:
                known[:], before = found, NO_LAGS
        elif found is not None:
            known[UU:] *= KEPT
            known += found
        claimed = _claimed(known, step, before)
        if any(_is_refuted(claimed, partial(score, rho=colour), step) for colour in {0.0, rho}):
            known[:] = 0.0
    claimed = _claimed(known, step, before)
    U, Q = (x if fixed is None else fixed for x, fixed in zip(claimed, given, strict=True))
    return U, Q


def excess(rows: Floats, before: Pair, now: Pair) -> float:
    """Return the relative excess of the residual squares with the lags ``before``."""
    rows, _ = _calmed(rows)
    larger, least = (kernel.misfit(rows, *lags, 0.0)[0] for lags in (before, now))
    return max(larger / max(least, 1e-12 * larger, 1e-30) - 1.0, 0.0)


def delay(lag: float, step: float) -> float:
    """Delay of samples ``step`` s apart by a first-order ``lag``, s.

    >>> round(delay(0.2, 0.01), 3), round(delay(0.02, 0.1), 4)
    (0.195, 0.0007)
    """
    return step / math.expm1(min(step / lag, MOST_STEPS)) if lag > 0.0 else 0.0


def _calmed(rows: Floats) -> tuple[Floats, bool]:
    """Return the rows without jitter of U and s, and whether there was any."""
    rows, is_jittery = np.array(rows, np.float64), False
    for column, unit in ((kernel.LEFT_U, 1.0), (kernel.LEFT_S, PERCENT_OF_S)):
        if jitter.is_small(unit * rows[:, column]):
            rows[:, column], is_jittery = jitter.taken_off(rows[:, column]), True
    return rows, is_jittery


def _lags(delays: Pair, step: float) -> Pair:
    U, Q = (step / math.log1p(step / x) if x > 0.0 else 0.0 for x in delays)
    return U, Q


def _usual_step(rows: Floats) -> float:
    steps = rows[:, kernel.STEP]
    within = steps[(steps > 0.0) & (steps < kernel.GAP)]
    return float(np.median(within)) if len(within) else kernel.GAP


def _is_refuted(claimed: Pair, score: Callable[[Pair], float], step: float) -> bool:
    """Whether these rows are clearly better explained without the accepted lags.

    The quadratic approximation fails where J is flat and its minimum is far away. With noise whose
    correlation time equals a lag, the lag is hardly identifiable.
    """
    U, Q = claimed
    if U == Q == 0.0:
        return False
    return bool(score((delay(U, step), delay(Q, step))) - score((0.0, 0.0)) > CLEAR)


def _moved(rows: Floats, column: int) -> float:
    """Return the travel of a signal, in units of its range."""
    signal = rows[:, column]
    scale = max(float(np.ptp(signal)), 100.0 if column == kernel.LEFT_U else 1e-9)
    return float(np.abs(np.diff(signal[::SPARSE])).sum()) / scale


def _search(score: Callable[[Pair], float], near: Pair | None, free: tuple[bool, bool]) -> Pair:
    """Return the pair with the lowest score, from the known pair or from a coarse grid.

    The score has a narrow diagonal valley, since one lag can replace the other. The search
    therefore also starts at its ends, where one lag has the sum of both.
    """
    if near is not None:
        return _descended(score, min((near, (0.0, 0.0)), key=score), free)
    tried = product(TRIED_U if free[0] else (0.0,), TRIED_Q if free[1] else (0.0,))
    near = _stepped(score, min(tried, key=score), free)
    begun = (near, (0.0, sum(near)), (sum(near), 0.0)) if all(free) else (near,)
    return min((_descended(score, pair, free) for pair in dict.fromkeys(begun)), key=score)


def _descended(score: Callable[[Pair], float], near: Pair, free: tuple[bool, bool]) -> Pair:
    """Damped Newton steps from a pair, as long as they lower the score."""
    least = score(near)
    for _ in range(NEWTONS):
        bowl = _bowl(score, near, free)
        if bowl is None:
            return near
        way = np.array(_resolved(bowl)) - near
        for share in SHARES:
            candidate = near[0] + share * float(way[0]), near[1] + share * float(way[1])
            if (found := score(candidate)) < least:
                break
        else:
            return near
        near, gain, least = candidate, least - found, found
        if gain < LEAST_GAIN:
            return near
    return near


def _stepped(score: Callable[[Pair], float], best: Pair, free: tuple[bool, bool]) -> Pair:
    """Coordinate search with step halving."""
    least, steps = score(best), [max(FIRST_STEP * x, LEAST_STEP) for x in best]
    for _ in range(ROUNDS):
        for k, sign in product((0, 1), (1.0, -1.0)):
            if not free[k]:
                continue
            moved = [*best]
            moved[k] = min(max(moved[k] + sign * steps[k], 0.0), MOST)
            candidate = moved[0], moved[1]
            if candidate != best and (found := score(candidate)) < least:
                best, least = candidate, found
                break
        else:
            steps = [step / 2.0 for step in steps]
    return best


def _bowl(score: Callable[[Pair], float], at: Pair, free: tuple[bool, bool]) -> Floats | None:
    """Return 1, Λ (uu, uq, qq) and Λ·x̂ (u, q) by finite differences of the score.

    A lag that is not ``free``, since its signal stood still, gets no information.
    """
    if not free[1]:
        return None
    h = NEAR
    U, Q = (max(x, h) for x in at)
    here, less_Q, more_Q = score((U, Q)), score((U, Q - h)), score((U, Q + h))
    qq = (more_Q + less_Q - 2.0 * here) / (2.0 * h**2)
    if not free[0]:
        b_Q = qq * Q - (more_Q - less_Q) / (4.0 * h)
        return np.array([1.0, 0.0, 0.0, qq, 0.0, b_Q]) if qq > 0.0 else None
    less_U, more_U = score((U - h, Q)), score((U + h, Q))
    less, more = score((U - h, Q - h)), score((U + h, Q + h))
    uu = (more_U + less_U - 2.0 * here) / (2.0 * h**2)
    uq = (more + less + 2.0 * here - more_U - less_U - more_Q - less_Q) / (4.0 * h**2)
    slope = np.array([more_U - less_U, more_Q - less_Q]) / (4.0 * h)
    bends, ways = np.linalg.eigh(np.array([[uu, uq], [uq, qq]]))
    slope = ways @ ((bends > LEAST_BEND) * (ways.T @ slope))
    bends = np.maximum(bends, LEAST_BEND)
    (uu, uq), (_, qq) = (ways * bends) @ ways.T
    b_U, b_Q = np.array([uu * U + uq * Q, uq * U + qq * Q]) - slope
    return np.array([1.0, uu, uq, qq, b_U, b_Q])


def _claim_no_more(
    found: Floats, score: Callable[[Pair], float], at: Pair, free: tuple[bool, bool]
) -> None:
    """Reduce a search's information to the actual rise of J away from the minimum.

    J is compared without lags and at the valley's ends: the curvature at one of two minima does not
    represent the other.
    """
    least, here = score(at), np.array(_resolved(found))
    both = sum(at)
    for elsewhere in ((0.0, 0.0), (0.0, both), (both, 0.0)) if all(free) else ((0.0, 0.0),):
        information = np.array([[found[UU], found[UQ]], [found[UQ], found[QQ]]])
        push = information @ (elsewhere - here)
        claim, gain = float(push @ (elsewhere - here)), max(score(elsewhere) - least, LEAST_GAIN)
        if claim > gain:
            information -= (1.0 - gain / claim) / claim * np.outer(push, push)
            found[[UU, UQ, QQ]] = information[[0, 0, 1], [0, 1, 1]]
            found[B_U:] = information @ here


def _resolved(known: Floats) -> Pair:
    """Return the minimum of the combined score, with neither delay below 0."""
    _, uu, uq, qq, b_U, b_Q = known.tolist()
    if uu == 0.0:
        return 0.0, min(max(b_Q / qq, 0.0), MOST)
    determinant = uu * qq - uq * uq
    U, Q = (qq * b_U - uq * b_Q) / determinant, (uu * b_Q - uq * b_U) / determinant
    if U < 0.0:
        U, Q = 0.0, b_Q / qq
    if Q < 0.0:
        U, Q = max(b_U / uu, 0.0), 0.0
    return min(U, MOST), min(max(Q, 0.0), MOST)


def _claimed(known: Floats, step: float, before: Pair) -> Pair:
    """Return the accepted lags; ``before`` are those accepted so far."""
    if not known[LOOKED]:
        return NO_LAGS
    _, uu, uq, qq, b_U, b_Q = known.tolist()
    U, Q = _resolved(known)

    def excess(u: float, q: float) -> float:
        return float(uu * u * u + 2.0 * uq * u * q + qq * q * q - 2.0 * (b_U * u + b_Q * q))

    only_U = max(b_U / uu, 0.0) if uu > 0.0 else 0.0, 0.0
    only_Q = 0.0, max(b_Q / qq, 0.0)
    single = min((only_U, only_Q), key=lambda pair: excess(*pair))
    both_clear, one_clear = (STILL_CLEAR if were(before) else CLEAR for were in (all, any))
    chosen = (U, Q) if excess(*single) - excess(U, Q) > both_clear else single
    if -excess(*chosen) < one_clear:
        return NO_LAGS
    U, Q = (min(x, MOST) if x >= LEAST else 0.0 for x in chosen)
    return _lags((U, Q), step)
