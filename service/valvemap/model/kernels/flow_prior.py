"""The prior of the map: second differences, and weak observations of no flow at s = 0.

Rows of the prior are stencils, products of three weights along U and three along s:

    BEND   (i, j): Δ²_U c / √(s_j² + s_1²)      precision lam[BEND]·w[i]
    CURVE  (i, k): Δ²_s c                        precision lam[CURVE]·v[k]
    TWIST  (i, k): Δ²_U Δ²_s c                   precision lam[TWIST]·w[i]
    ZERO   (i): flow at s = 0                    precision lam[ZERO]

A bend of U's curve that holds at every Δp (a dead band, a saturation) grows with s; hence the
root. w are the local precisions along U (Student-t), v along s.
"""

import math

from valvemap.model.kernels.compiled import inner
from valvemap.model.kernels.flow_basis import Axis, interval, values
from valvemap.model.samples import Floats

BEND, CURVE, TWIST, ZERO, FAMILIES = 0, 1, 2, 3, 4


@inner
def rows_of(family: int, n_U: int, n_s: int) -> tuple[int, int]:
    """How many rows a family has along U and along s."""
    if family == BEND:
        return n_U - 2, n_s
    if family == CURVE:
        return n_U, n_s - 2
    if family == TWIST:
        return n_U - 2, n_s - 2
    return n_U, 1


@inner
def stencil(
    family: int, i: int, j: int, axis_s: Axis, along_U: Floats, along_s: Floats
) -> tuple[int, int, int, int]:
    """Fill the weights of a row; give where it begins and how many weights it has each way."""
    along_U[:] = 1.0
    along_s[:] = 1.0
    at_s, many_U, many_s = j, 1, 1
    if family in (BEND, TWIST):
        along_U[1] = -2.0
        many_U = 3
    if family == BEND:
        least = axis_s.breaks[-1] - axis_s.breaks[-2]
        along_s[0] = 1.0 / math.sqrt(axis_s.sites[j] ** 2 + (0.2 * least) ** 2)
    if family in (CURVE, TWIST):
        for b in range(3):
            along_s[b] = axis_s.bends[j, b]
        many_s = 3
    if family == ZERO:
        at_s, many_s = interval(axis_s, 0.0), 3
        values(axis_s, at_s, 0.0, 0.0, along_s)
    return i, at_s, many_U, many_s


@inner
def local(family: int, i: int, j: int, w: Floats, v: Floats) -> float:
    """Local precision of a row."""
    if family in (BEND, TWIST):
        return float(w[i])
    if family == CURVE:
        return float(v[j])
    return 1.0


@inner
def add(
    axis_U: Axis, axis_s: Axis, lam: Floats, w: Floats, v: Floats, work: Floats, A: Floats
) -> None:
    """Add the prior's precision to the band ``A``, see `kernels.banded`; ``work`` is (2, 3)."""
    n_U, n_s = len(axis_U.sites), len(axis_s.sites)
    band = 2 * n_s + 3
    for family in range(FAMILIES):
        many_i, many_j = rows_of(family, n_U, n_s)
        for i in range(many_i):
            for j in range(many_j):
                at_U, at_s, many_U, many_s = stencil(family, i, j, axis_s, work[0], work[1])
                precision = lam[family] * local(family, i, j, w, v)
                first = at_U * n_s + at_s
                for a in range(many_U):
                    for b in range(many_s):
                        p, x = a * n_s + b, precision * work[0, a] * work[1, b]
                        for c in range(a, many_U):
                            for d in range(b if c == a else 0, many_s):
                                q = c * n_s + d
                                A[(first + p) * band + q - p] += x * work[0, c] * work[1, d]


@inner
def forms(
    axis_U: Axis, axis_s: Axis, beta: Floats, border: Floats, Z: Floats, Z_prior: Floats,
    work: Floats, found_U: Floats, found_s: Floats, totals: Floats, w: Floats, v: Floats,
) -> None:  # fmt: skip
    """What the map says of each row of the prior, summed.

    found_U (2, n_U - 2, 2) for BEND and TWIST by i, found_s (n_s - 2, 2) for CURVE by k: squares of
    the rows, and how much narrower they are than the prior leaves them, unweighted. totals
    (FAMILIES, 2): the same, weighted by the local precisions. ``border`` (m, n): the posterior's
    covariance is that of the band Z plus borderᵀ·border.
    """
    n_U, n_s = len(axis_U.sites), len(axis_s.sites)
    band = 2 * n_s + 3
    middle, width = band - 1, 2 * band - 1
    found_U[:], found_s[:], totals[:] = 0.0, 0.0, 0.0
    for family in range(FAMILIES):
        many_i, many_j = rows_of(family, n_U, n_s)
        for i in range(many_i):
            for j in range(many_j):
                at_U, at_s, many_U, many_s = stencil(family, i, j, axis_s, work[0], work[1])
                first, row, narrower = at_U * n_s + at_s, 0.0, 0.0
                for a in range(many_U):
                    for b in range(many_s):
                        p, x = a * n_s + b, work[0, a] * work[1, b]
                        row += x * beta[first + p]
                        here = (first + p) * width + middle
                        narrower += x * x * (Z_prior[here] - Z[here])
                        for c in range(a, many_U):
                            for d in range(b + 1 if c == a else 0, many_s):
                                q = c * n_s + d
                                y = 2.0 * x * work[0, c] * work[1, d]
                                narrower += y * (Z_prior[here + q - p] - Z[here + q - p])
                for m in range(len(border)):
                    along = 0.0
                    for a in range(many_U):
                        for b in range(many_s):
                            along += work[0, a] * work[1, b] * border[m, first + a * n_s + b]
                    narrower -= along * along
                square, narrower = row * row, max(narrower, 0.0)
                weight = local(family, i, j, w, v)
                totals[family, 0] += weight * square
                totals[family, 1] += weight * narrower
                if family == CURVE:
                    found_s[j, 0] += square
                    found_s[j, 1] += narrower
                if family in (BEND, TWIST):
                    which = 0 if family == BEND else 1
                    found_U[which, i, 0] += square
                    found_U[which, i, 1] += narrower
