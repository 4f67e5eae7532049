"""Theta refitted to the flows of all nodes, while the plant drifts."""

import numpy as np

from valvemap.model.kernels.compiled import maker
from valvemap.model.kernels.factors import back_substitute, independence, rotate_in
from valvemap.model.kernels.information_form import INDEPENDENT, settle
from valvemap.model.kernels.place_layout import APART, KNOWN, TOUCHED, VISITS, Remembered
from valvemap.model.kernels.row_layout import FLOOR, GAP, LAG, places_of
from valvemap.model.samples import Floats

EQUAL = 16.0  # looks from which all places have equal weight


@maker
def refit(s: Floats, R: Floats, rhs: Floats, own: Remembered, nodes: Floats, now: float) -> None:
    """Fit theta and P = U·D·Uᵀ by least squares to the flows of all nodes, weighted by information.

    ``R`` and ``rhs`` are scratch and left empty. If the nodes do not determine theta, it is kept.
    """
    flows, places, visits = own
    n = len(rhs)
    at = places_of(n)
    g = at.detector
    gap, ageing = max(s[g + GAP], APART), 0.0  # ageing of a place's variance, 1/samples²
    if s[g + FLOOR] > 0.0:
        ageing = max(s[g + LAG], 0.0) / (s[g + FLOOR] * gap * gap)
    scale, x = s[at.scale : at.scale + n], np.empty(n)
    for k in range(len(flows)):
        if visits[k, VISITS] > 0:
            aged = ageing * (now - places[k, TOUCHED]) ** 2
            root = np.sqrt(1.0 / (1.0 / min(places[k, KNOWN], EQUAL) + aged))
            for j in range(n):
                x[j] = root * nodes[k, j]
            rotate_in(R, rhs, x, root * flows[k], 1.0, scale, k)
    if independence(R) > INDEPENDENT:
        back_substitute(R, rhs, s[at.theta : at.theta + n])
        settle(s, R)
        for p in range(at.spread, at.variance):
            s[p] = 0.0
    for j in range(n):
        rhs[j] = 0.0
        for k in range(n):
            R[j, k] = 0.0
