"""Stability of D(q) = 1 + d1·q⁻¹ + … + dm·q⁻ᵐ."""

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.samples import Floats


@kernel
def is_stable(d: Floats, radius: float) -> bool:
    """Whether all roots of zᵐ + d1·zᵐ⁻¹ + … + dm lie inside ``radius`` (Schur and Cohn)."""
    return lies_inside(d, radius, np.empty(len(d)))


@inner
def lies_inside(d: Floats, radius: float, a: Floats) -> bool:
    """`is_stable`; ``a`` (m or more,) is scratch."""
    m = len(d)
    if m == 0:
        return True
    if m == 1:
        return bool(abs(d[0]) < radius)
    shrink = 1.0
    for i in range(m):
        shrink /= radius
        a[i] = d[i] * shrink
    for k in range(m - 1, -1, -1):
        reflection = a[k]
        if not abs(reflection) < 1.0:
            return False
        rest = 1.0 - reflection * reflection
        for i in range((k + 1) // 2):
            low, high = a[i], a[k - 1 - i]
            a[i] = (low - reflection * high) / rest
            a[k - 1 - i] = (high - reflection * low) / rest
    return True


@kernel
def root_margins(d: Floats) -> Floats:
    """1 - max|root of D| for each of N polynomials, rows of ``d`` (N, m), to 1e-9."""
    margins = np.ones(len(d))
    for t in range(len(d)):
        low = 0.0
        high = 1.0
        while not is_stable(d[t], high) and high < 1e12:
            low = high
            high *= 2.0
        while high - low > 1e-9:
            middle = 0.5 * (low + high)
            if is_stable(d[t], middle):
                high = middle
            else:
                low = middle
        margins[t] = 1.0 - high
    return margins
