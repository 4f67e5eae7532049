"""The loop that asks whether eq. (7) is enough: moments of its terms, of further ones, and of Q.

The terms are sorted: those of eq. (7), then six that bend it, then Q. In the Cholesky factor of
their moments the last row then holds, one by one, what each further term explains of Q that those
before it do not.
"""

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.samples import Codes, Floats, Segments

# Exponents of U/100 and of s/10, s·|s| for the square: eq. (7), then what bends it.
EXPONENTS = (
    (0, 0), (1, 0), (0, 1), (1, 1), (0, 2),
    (2, 1), (1, 2), (3, 1), (2, 0), (0, 3), (3, 0),
)  # fmt: skip
FIVE, TERMS = 5, 11
WIDE = TERMS + 1  # with Q

# Places in the memory of one map; triangles are lower ones, row by row.
MOMENTS = 0  # of terms and Q, over the blocks so far
TRIANGLE = WIDE * (WIDE + 1) // 2
PRESENT = MOMENTS + TRIANGLE  # the same of the present block
SPREAD = PRESENT + TRIANGLE  # Σ score·scoreᵀ over the blocks: the long-run covariance of term·e
SEEN, BLOCKS, JUDGED = (SPREAD + TERMS * (TERMS + 1) // 2 + k for k in range(3))
PLACES = JUDGED + 1

BLOCK = 256.0  # samples; longer than the noise remembers, 2.6 s at 100 Hz
KEPT = 1.0 - 1.0 / 256.0  # of the moments, per block: some 65,000 samples count
PLENTY, EVERY = 8192.0, 8.0  # so many samples are all taken in, then each eighth
DETERMINED = 1e-9  # share of a moment that the terms before must leave, for a term to be told apart
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
    """Take the samples in that were learnt from, in place; ``every_fit`` is (M, PLACES)."""
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
    """Add the block to the moments, and what it says against their theta to the covariance."""
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
    """Write the parameters of all terms; those that are open are 0."""
    for j in range(TERMS - 1, -1, -1):
        total = L[TERMS, j]
        for k in range(j + 1, TERMS):
            total -= L[k, j] * theta[k]
        theta[j] = total / L[j, j] if L[j, j] > 0.0 else 0.0


@inner
def factorise(fit: Floats, L: Floats) -> None:
    """Write the Cholesky factor (WIDE, WIDE) of all moments; a column is 0 where a term is open.

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
    """Write how much each further term explains of Q, in standard deviations, (6,) each.

    Returns
    -------
    float
        Variance of the residuals of all terms, (l/min)²; NaN while there are too few samples.

    Parameters
    ----------
    contrasts
        Written: if the noise is white; NaN where a term cannot be told from those before it.
    long_run
        Written: by the covariance of the blocks' scores, whatever the noise's colour.
    """
    L, a = np.empty((WIDE, WIDE)), np.empty(TERMS)
    factorise(fit, L)
    number = fit[MOMENTS] + fit[PRESENT]  # the first moments are those of 1·1
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
    """Write what the first ``bends`` further terms could hide at N points, over the noise's std.

    Infinite where a term of eq. (7) or one of those cannot be told from the others.
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
        for j in range(last):  # z = L⁻¹·row: the terms made orthonormal over the samples
            z[j] = row[j]
            for k in range(j):
                z[j] -= L[j, k] * z[k]
            z[j] /= L[j, j]
            if j >= FIVE:
                total += z[j] * z[j]
        out[i] = np.sqrt(total)


@inner
def _orthonormal(L: Floats, j: int, a: Floats) -> None:
    """Write row j of L⁻¹: the combination of terms that the samples see as the j-th alone."""
    a[:] = 0.0
    a[j] = 1.0 / L[j, j]
    for k in range(j - 1, -1, -1):
        total = 0.0
        for i in range(k + 1, j + 1):
            total -= a[i] * L[i, k]
        a[k] = total / L[k, k] if L[k, k] > 0.0 else 0.0
