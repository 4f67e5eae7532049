"""Lack-of-fit test of eq. (7): moments of its terms, of further terms, and of Q.

The terms are ordered: those of eq. (7), six further terms, Q. In the Cholesky factor of their
moments, the last row then contains the contribution of each further term to Q, beyond the terms
before it.
"""

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.samples import Codes, Floats, Segments

# Exponents of U/100 and of s/10, s·|s| for the square: eq. (7), then the further terms.
EXPONENTS = (
    (0, 0), (1, 0), (0, 1), (1, 1), (0, 2),
    (2, 1), (1, 2), (3, 1), (2, 0), (0, 3), (3, 0),
)  # fmt: skip
FIVE, TERMS = 5, 11
WIDE = TERMS + 1  # with Q

# Offsets in the memory of one map; triangles are lower, by rows.
MOMENTS = 0  # of terms and Q, over all completed blocks
TRIANGLE = WIDE * (WIDE + 1) // 2
PRESENT = MOMENTS + TRIANGLE  # the same over the current block
SPREAD = PRESENT + TRIANGLE  # Σ score·scoreᵀ over the blocks: long-run covariance of term·e
SEEN, BLOCKS, JUDGED = (SPREAD + TERMS * (TERMS + 1) // 2 + k for k in range(3))
PLACES = JUDGED + 1

BLOCK = 256.0  # samples; longer than the noise's correlation, 2.6 s at 100 Hz
KEPT = 1.0 - 1.0 / 256.0  # of the moments, per block: memory of some 65,000 samples
PLENTY, EVERY = 8192.0, 8.0  # the first 8192 samples are all used, then every 8th
DETERMINED = 1e-9  # residual share of a moment below which a term is not identifiable
_LEARNT = 2  # Status.UNEXCITED
_LARGEST = 1e6


@kernel
def learn(
    U: Floats,
    dp: Floats,
    Q: Floats,
    status: Codes,
    every_fit: Floats,
    segments: Segments,
) -> None:
    """Update with the samples that the estimator used, in place; ``every_fit`` is (M, PLACES)."""
    members, starts, stops = segments
    row, L = np.empty(WIDE), np.empty((WIDE, WIDE))
    theta, score = np.empty(TERMS), np.empty(TERMS)
    for k in range(len(members)):
        fit = every_fit[members[k]]
        for i in range(starts[k], stops[k]):
            usable = status[i] <= _LEARNT and max(abs(U[i]), abs(dp[i]), abs(Q[i])) < _LARGEST
            if not usable:
                continue
            fit[SEEN] += 1.0
            if fit[SEEN] > PLENTY and fit[SEEN] % EVERY != 0.0:
                continue
            terms(U[i], dp[i], row)
            row[TERMS] = Q[i]
            _take(fit, row)
            if fit[SEEN] % BLOCK == 0.0:
                _close_block(fit, L, theta, score)


@inner
def terms(U: float, dp: float, row: Floats) -> None:
    """Write the eleven terms at a point."""
    u, s = U / 100.0, np.sqrt(abs(dp)) / 10.0
    if dp < 0.0:
        s = -s
    square = s * abs(s)
    row[0], row[1], row[2], row[3], row[4] = 1.0, u, s, u * s, square
    row[5], row[6], row[7] = u * u * s, u * square, u * u * u * s
    row[8], row[9], row[10] = u * u, s * s * s, u * u * u


@inner
def _take(fit: Floats, row: Floats) -> None:
    p = PRESENT
    for j in range(WIDE):
        for k in range(j + 1):
            fit[p] += row[j] * row[k]
            p += 1


@inner
def _close_block(fit: Floats, L: Floats, theta: Floats, score: Floats) -> None:
    """Add the block to the moments, and its score at their theta to the covariance."""
    factorise(fit, L)
    _solve(L, theta)
    score[:] = 0.0
    p = PRESENT
    for j in range(WIDE):
        for k in range(j + 1):
            if j == TERMS and k < TERMS:
                score[k] += fit[p]
            elif j < TERMS:
                score[j] -= fit[p] * theta[k]
                if k < j:
                    score[k] -= fit[p] * theta[j]
            fit[p - PRESENT] = KEPT * (fit[p - PRESENT] + fit[p])
            p += 1
    fit[JUDGED] = KEPT * (fit[JUDGED] + fit[PRESENT])
    fit[PRESENT:SPREAD] = 0.0
    p = SPREAD
    for j in range(TERMS):
        for k in range(j + 1):
            fit[p] = KEPT * KEPT * (fit[p] + score[j] * score[k])
            p += 1
    fit[BLOCKS] += 1.0


@inner
def _solve(L: Floats, theta: Floats) -> None:
    """Write the parameters of all terms; 0 where undetermined."""
    for j in range(TERMS - 1, -1, -1):
        total = L[TERMS, j]
        for k in range(j + 1, TERMS):
            total -= L[k, j] * theta[k]
        theta[j] = total / L[j, j] if L[j, j] > 0.0 else 0.0


@inner
def factorise(fit: Floats, L: Floats) -> None:
    """Write the Cholesky factor (WIDE, WIDE) of all moments; columns of undetermined terms are 0.

    The last diagonal element is the root of the residual squares.
    """
    p = MOMENTS
    for j in range(WIDE):
        for k in range(j + 1):
            total = fit[p] + fit[p + TRIANGLE]
            p += 1
            own = total
            for i in range(k):
                total -= L[j, i] * L[k, i]
            if k < j:
                L[j, k] = total / L[k, k] if L[k, k] > 0.0 else 0.0
                L[k, j] = 0.0
            elif j == TERMS:
                L[j, j] = np.sqrt(max(total, 0.0))
            else:
                L[j, j] = np.sqrt(total) if total > DETERMINED * own else 0.0


@kernel
def judge(fit: Floats, contrasts: Floats, long_run: Floats) -> float:
    """Write the contribution of each further term to Q, in standard deviations, (6,) each.

    Returns
    -------
    float
        Variance of the residuals of all terms, (l/min)²; NaN while there are too few samples.

    Parameters
    ----------
    contrasts
        Written: in white noise; NaN where a term is not identifiable.
    long_run
        Written: with the covariance of the blocks' scores, in noise of any colour.
    """
    L, a = np.empty((WIDE, WIDE)), np.empty(TERMS)
    factorise(fit, L)
    number = fit[MOMENTS] + fit[PRESENT]  # the first moment is that of 1·1
    freedom = number - TERMS
    contrasts[:] = np.nan
    long_run[:] = np.nan
    if freedom <= 0.0:
        return np.nan
    variance = L[TERMS, TERMS] ** 2 / freedom
    for j in range(FIVE, TERMS):
        if L[j, j] == 0.0:
            continue
        contrasts[j - FIVE] = L[TERMS, j] / np.sqrt(variance)
        _orthonormal(L, j, a)
        total = 0.0
        p = SPREAD
        for i in range(TERMS):
            for k in range(i + 1):
                total += (1.0 if i == k else 2.0) * a[i] * a[k] * fit[p]
                p += 1
        if fit[JUDGED] > 0.0 and total > 0.0:
            long_run[j - FIVE] = L[TERMS, j] / np.sqrt(total * number / fit[JUDGED])
    return float(variance)


@kernel
def bent(fit: Floats, U: Floats, dp: Floats, out: Floats) -> None:
    """Write the flow by all terms at N points."""
    L, row, theta = np.empty((WIDE, WIDE)), np.empty(WIDE), np.empty(TERMS)
    factorise(fit, L)
    _solve(L, theta)
    for i in range(len(U)):
        terms(U[i], dp[i], row)
        out[i] = 0.0
        for j in range(TERMS):
            out[i] += row[j] * theta[j]


@kernel
def hidden(fit: Floats, U: Floats, dp: Floats, bends: int, out: Floats) -> None:
    """Write the undetectable part of the first ``bends`` further terms at N points, in noise std.

    Infinite if a term of eq. (7) or one of these is not identifiable.
    """
    L, row, z = np.empty((WIDE, WIDE)), np.empty(WIDE), np.empty(TERMS)
    factorise(fit, L)
    last = FIVE + bends
    known = True
    for j in range(last):
        known &= L[j, j] > 0.0
    for i in range(len(U)):
        out[i] = np.inf
        if not known:
            continue
        terms(U[i], dp[i], row)
        total = 0.0
        for j in range(last):  # z = L⁻¹·row: the terms orthonormalized over the samples
            z[j] = row[j]
            for k in range(j):
                z[j] -= L[j, k] * z[k]
            z[j] /= L[j, j]
            if j >= FIVE:
                total += z[j] * z[j]
        out[i] = np.sqrt(total)


@inner
def _orthonormal(L: Floats, j: int, a: Floats) -> None:
    """Write row j of L⁻¹: the j-th orthonormalized term."""
    a[:] = 0.0
    a[j] = 1.0 / L[j, j]
    for k in range(j - 1, -1, -1):
        total = 0.0
        for i in range(k + 1, j + 1):
            total -= a[i] * L[i, k]
        a[k] = total / L[k, k] if L[k, k] > 0.0 else 0.0
