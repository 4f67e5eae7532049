"""Which lags lie between U, the flow, and the flow shown: those that leave least unexplained.

A map that is linear in its parameters lags as its regressors do, so for any pair of lags the best
coarse map, and what it leaves, follow by least squares (:func:`kernels.lag.misfit`). A look finds
the pair that leaves least in the last samples, and how sharply, after what noise repeats from
sample to sample is taken off. Looks add up as information does::

    J(x) = N·ln(squares) ~ (x - x̂)ᵀ·Λ·(x - x̂),   Σ = ΣΛ,   b = ΣΛ·x̂,   x = Σ⁻¹·b

A lag is claimed if without it J would be larger by CLEAR.
"""

import math
from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Final

import numpy as np

from service.identification.kernels import lag as kernel
from service.identification.samples import Floats

TRIED_U: Final = (0.0, 0.03, 0.1)  # s
TRIED_Q: Final = (0.0, 0.03, 0.08, 0.2, 0.45)  # s
MOST: Final = 0.6  # s: slower ones are not looked for
LEAST: Final = 0.010  # s: less is none, one sample at 100 Hz
FIRST_STEP: Final = 0.3  # of a lag, or LEAST_STEP: the first step of the search
LEAST_STEP: Final = 0.006  # s
FIRST_ROUNDS, LATER_ROUNDS = 6, 3  # times that the step may be halved
LEAST_WAY: Final = 1.0  # ranges that U must travel within the rows to tell its lag, and Q its own
SPARSE: Final = 20  # every so many rows the way is measured, so that noise does not count
LEAST_ROWS: Final = 200
CLEAR: Final = 40.0  # gain in J: a clear lag
COLOURS: Final = (0.0, 0.3, 0.6, 0.8, 0.9, 0.95, 0.98)  # correlation of what a map leaves
KEPT: Final = 0.9  # share of what was known that stays known after a look: lags may change
LOOKED, UU, UQ, QQ, B_U, B_Q = range(6)  # places in `known`

Pair = tuple[float, float]  # lag of U's effect and of the meter, s


def look(rows: Floats, known: Floats, given: tuple[float | None, float | None]) -> Pair:
    """Lags after a look at ``rows``, see :func:`kernels.lag.keep`; ``known`` (6,) is written.

    The first look searches everywhere, later ones around what is known.
    """
    rows = np.ascontiguousarray(rows, np.float64)
    squares, counted = kernel.misfit(rows, 0.0, 0.0, 0.0)
    if counted >= LEAST_ROWS and squares > 0.0:

        def score(lags: Pair, rho: float) -> float:
            left = kernel.misfit(rows, *lags, rho)[0]
            return float(counted * math.log(max(left, 1e-12 * squares)))

        near = _resolved(known) if known[LOOKED] else None
        free = _moved(rows, kernel.LEFT_U) >= LEAST_WAY, _moved(rows, kernel.LEFT_Q) >= LEAST_WAY
        at = _search(partial(score, rho=0.0), near, free)
        rho = min(COLOURS, key=lambda rho: score(at, rho))
        if rho:
            at = _search(partial(score, rho=rho), near, free)
        found = _information(partial(score, rho=rho), at, free)
        if found is not None:
            known[UU:] *= KEPT
            known[UU:] += found
            known[LOOKED] += 1.0
    claimed = _claimed(known)
    U, Q = (x if fixed is None else fixed for x, fixed in zip(claimed, given, strict=True))
    return U, Q


def _moved(rows: Floats, column: int) -> float:
    """Way of a signal, in its ranges."""
    signal = rows[:, column]
    scale = max(float(np.ptp(signal)), 100.0 if column == kernel.LEFT_U else 1e-9)
    return float(np.abs(np.diff(signal[::SPARSE])).sum()) / scale


def _search(score: Callable[[Pair], float], near: Pair | None, free: tuple[bool, bool]) -> Pair:
    """Steps along either lag, and halves of them, as long as they lower the score."""
    tried = product(TRIED_U if free[0] else (0.0,), TRIED_Q if free[1] else (0.0,))
    best = min(tried, key=score) if near is None else near
    least = score(best)
    steps = [max(FIRST_STEP * x, LEAST_STEP) for x in best]
    for _ in range(FIRST_ROUNDS if near is None else LATER_ROUNDS):
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


def _information(
    score: Callable[[Pair], float], at: Pair, free: tuple[bool, bool]
) -> Floats | None:
    """Λ (uu, uq, qq) and Λ·x̂ (u, q) from the score's differences around a pair.

    Nothing is known of a lag that is not free: its signal stood still.
    """
    h_U, h_Q = (max(FIRST_STEP / 2.0 * x, LEAST_STEP) for x in at)
    U, Q = max(at[0], h_U), max(at[1], h_Q)
    here, both = score((U, Q)), score((U + h_U, Q + h_Q))
    less_U, more_U = score((U - h_U, Q)), score((U + h_U, Q))
    less_Q, more_Q = score((U, Q - h_Q)), score((U, Q + h_Q))
    uu = (more_U + less_U - 2.0 * here) / (2.0 * h_U**2)
    qq = (more_Q + less_Q - 2.0 * here) / (2.0 * h_Q**2)
    uq = (both - more_U - more_Q + here) / (2.0 * h_U * h_Q)
    if not (uu > 0.0 and qq > 0.0 and uu * qq > uq * uq) or not free[1]:
        return None
    if not free[0]:
        return np.array([0.0, 0.0, qq, 0.0, qq * Q - (more_Q - less_Q) / (4.0 * h_Q)])
    b_U = uu * U + uq * Q - (more_U - less_U) / (4.0 * h_U)
    b_Q = uq * U + qq * Q - (more_Q - less_Q) / (4.0 * h_Q)
    return np.array([uu, uq, qq, b_U, b_Q])


def _resolved(known: Floats) -> Pair:
    """The pair that all looks together say, neither below 0."""
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


def _claimed(known: Floats) -> Pair:
    """... and those of them that are clear."""
    if not known[LOOKED]:
        return 0.0, 0.0
    _, uu, uq, qq, b_U, b_Q = known.tolist()
    U, Q = _resolved(known)

    def excess(u: float, q: float) -> float:
        return float(uu * u * u + 2.0 * uq * u * q + qq * q * q - 2.0 * (b_U * u + b_Q * q))

    only_U = max(b_U / uu, 0.0) if uu > 0.0 else 0.0, 0.0
    only_Q = 0.0, max(b_Q / qq, 0.0)
    single = min((only_U, only_Q), key=lambda pair: excess(*pair))
    chosen = (U, Q) if excess(*single) - excess(U, Q) > CLEAR else single
    if -excess(*chosen) < CLEAR:
        return 0.0, 0.0
    U, Q = (min(x, MOST) if x >= LEAST else 0.0 for x in chosen)
    return U, Q
