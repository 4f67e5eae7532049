"""Rank-one steps on the covariance P = U·D·Uᵀ, stored as a triangle in a model's row.

The triangle's row j holds U[0…j-1, j], then D[j]. P is always symmetric and positive definite. All
vectors are offsets in the same array ``s``, see :mod:`valvemap.model.kernels.row_layout`; all loops
run in a fixed order, for bit-identical results.
"""

from valvemap.model.kernels.compiled import inlined
from valvemap.model.kernels.row_layout import Size
from valvemap.model.samples import Floats

RIDGE = 1e-9


@inlined
def whiten(size: Size, s: Floats, ut: int, x: int, f: int) -> float:
    """F = Uᵀx; returns xᵀ·P·x."""
    r = 0.0
    p = ut
    for j in range(len(size)):
        total = s[x + j]
        row, before = s[p : p + j], s[x : x + j]
        for k in range(j):
            total += row[k] * before[k]
        s[f + j] = total
        r += total * total * s[p + j]
        p += j + 1
    return r


@inlined
def take_in(
    size: Size, s: Floats, ut: int, f: int, Px: int, alpha: float, weight: float, growth: float
) -> float:
    """P ← growth·(P - weight·P·x·xᵀ·P / (alpha + weight·xᵀ·P·x)), Bierman's recursion.

    ``f`` = Uᵀx. Writes P·x of the previous P, and returns 1/(alpha + weight·xᵀ·P·x).
    """
    inverse = 1.0 / alpha
    p = ut
    for j in range(len(size)):
        v = s[p + j] * s[f + j]
        step = -weight * s[f + j] * inverse
        following = alpha + weight * s[f + j] * v
        inverse = 1.0 / following
        s[p + j] *= alpha * inverse * growth
        alpha = following
        row, done = s[p : p + j], s[Px : Px + j]
        for k in range(j):
            u = row[k]
            row[k] = u + step * done[k]
            done[k] += u * v
        s[Px + j] = v
        p += j + 1
    return inverse


@inlined
def add_rank_one(size: Size, s: Floats, ut: int, v: int, weight: float) -> None:
    """P ← P + weight·v·vᵀ for weight ≥ 0, Agee and Turner's recursion; v is destroyed."""
    n = len(size)
    for back in range(n):
        j = n - 1 - back
        p = ut + j * (j + 1) // 2
        d, w = s[p + j], s[v + j]
        d_next = d + weight * w * w
        s[p + j] = d_next
        step = weight * w / d_next
        for k in range(j):
            s[v + k] -= w * s[p + k]
            s[p + k] += step * s[v + k]
        weight *= d / d_next


@inlined
def inform(size: Size, s: Floats, ut: int, v: int, g: int) -> float:
    """G = P⁻¹·v; returns vᵀ·P⁻¹·v."""
    n = len(size)
    for j in range(n):
        s[g + j] = s[v + j]
    total = 0.0
    for back in range(n):
        j = n - 1 - back
        p = ut + j * (j + 1) // 2
        w = s[g + j]
        for k in range(j):
            s[g + k] -= s[p + k] * w
        s[g + j] = w / s[p + j]
        total += w * s[g + j]
    p = ut
    for j in range(n):
        for k in range(j):
            s[g + j] -= s[p + k] * s[g + k]
        p += j + 1
    return total


@inlined
def scaled_trace(size: Size, s: Floats, ut: int, scale: int) -> float:
    """Trace of P in units of the columns' scales."""
    total = 0.0
    p = ut
    for j in range(len(size)):
        squares = s[scale + j] * s[scale + j]
        for k in range(j):
            u = s[p + k] * s[scale + k]
            squares += u * u
        total += s[p + j] * squares
        p += j + 1
    return total


@inlined
def add_square(size: Size, s: Floats, A: int, v: int, decay: float) -> None:
    """A ← decay·A + v·vᵀ."""
    p = A
    for j in range(len(size)):
        row, vs, w = s[p : p + j + 1], s[v : v + j + 1], s[v + j]
        for k in range(j + 1):
            row[k] = decay * row[k] + w * vs[k]
        p += j + 1


@inlined
def rotate(
    size: Size, s: Floats, A: int, x: int, v: int, g: int, taken: float, added: float
) -> None:
    """A ← B·A·Bᵀ + added·xxᵀ with B = I - taken·x·vᵀ of a symmetric A; ``g`` is scratch."""
    n = len(size)
    for j in range(n):
        s[g + j] = 0.0
    p = A
    for j in range(n):
        for k in range(j):
            s[g + j] += s[p + k] * s[v + k]
            s[g + k] += s[p + k] * s[v + j]
        s[g + j] += s[p + j] * s[v + j]
        p += j + 1
    total = 0.0
    for j in range(n):
        total += s[v + j] * s[g + j]
    added += taken * taken * total
    p = A
    for j in range(n):
        for k in range(j + 1):
            s[p + k] += added * s[x + j] * s[x + k] - taken * (
                s[x + j] * s[g + k] + s[g + j] * s[x + k]
            )
        p += j + 1


@inlined
def squared_length(size: Size, s: Floats, b: int, V: int, d: int, w: int, L: int) -> float:
    """BᵀV⁻¹b by the factors L·D·Lᵀ of V; ``d``, ``w`` and ``L`` are scratch, for D⁻¹, L⁻¹b, L·D.

    A direction that the others explain except for rounding errors is ignored.
    """
    total = 0.0
    row = 0
    for j in range(len(size)):
        rest = s[V + row + j] * (1.0 + RIDGE)
        s[w + j] = s[b + j]
        other = 0
        for k in range(j):
            u = s[V + row + k]
            for i in range(k):
                u -= s[L + row + i] * s[d + i] * s[L + other + i]
            s[L + row + k] = u
            rest -= u * u * s[d + k]
            s[w + j] -= u * s[d + k] * s[w + k]
            other += k + 1
        s[d + j] = 1.0 / rest if rest > RIDGE * s[V + row + j] else 0.0
        total += s[w + j] * s[w + j] * s[d + j]
        row += j + 1
    return total
