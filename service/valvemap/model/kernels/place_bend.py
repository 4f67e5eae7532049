"""The error of interpolation between nodes: the curvature of the residual along U."""

from valvemap.model.kernels.compiled import inlined
from valvemap.model.kernels.place_layout import KNOWN, LEAST, NODES_A, NODES_B, Remembered
from valvemap.model.kernels.row_layout import BEND, Places, Size
from valvemap.model.samples import Floats

BENT = 0.25  # of the nodes' second difference: interpolation error, rather more at a kink
BELIEVED = 2.0  # visits after which half of that error remains in the variance


@inlined
def bend(
    size: Size, s: Floats, at: Places, nodes: Floats, own: Remembered, i: int, j: int
) -> float:
    """Curvature of the residual along U around a cell, an estimate of the interpolation error."""
    largest, before, last = 0.0, 0.0, 0.0
    seen = 0
    for step in range(4):
        column = i - 1 + step
        k = column * NODES_B + j
        if column < 0 or column >= NODES_A or own.places[k, KNOWN] <= LEAST:
            seen = 0
            continue
        c = own.flows[k]
        for m in range(len(size)):
            c -= nodes[k, m] * s[at.theta + m]
        if seen >= 2:
            largest = max(largest, abs(before - 2.0 * last + c))
        before = last
        last = c
        seen += 1
    return BENT * largest


@inlined
def bent(s: Floats, g: int, visits: int) -> float:
    """Variance of the interpolation error around a node; decreases with each visit."""
    return float(s[g + BEND] * s[g + BEND] * BELIEVED / (BELIEVED + visits))
