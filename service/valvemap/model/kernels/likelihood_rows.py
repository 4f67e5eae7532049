"""Regressors of maximum likelihood from its channels, and the residual against them."""

import numpy as np

from valvemap.model.kernels.compiled import inner
from valvemap.model.kernels.likelihood_memory import (
    COUNT,
    DETERMINED,
    ROUNDING,
    Memory,
    Orders,
    Scratch,
    dot,
)
from valvemap.model.kernels.residual_spread import EARLIER
from valvemap.model.samples import Floats


@inner
def residual_of(h: Floats, theta: Floats, n: int, y: float) -> float:
    """Y - hᵀtheta; 0 below rounding error, to keep it out of the noise model."""
    total = y
    magnitude = abs(y)
    for j in range(n):
        part = h[j] * theta[j]
        total -= part
        magnitude += abs(part)
    return total if abs(total) > ROUNDING * magnitude else 0.0


@inner
def push(memory: Memory, d: Floats, c: int, value: float) -> None:
    """Shift a value into channel c, and value/D(q) into its filtered twin."""
    raw, filtered = memory.raw, memory.filtered
    through = value
    for i in range(len(d)):
        through -= d[i] * filtered[c, i]
    for i in range(raw.shape[1] - 1, 0, -1):
        raw[c, i] = raw[c, i - 1]
        filtered[c, i] = filtered[c, i - 1]
    raw[c, 0] = value
    filtered[c, 0] = through


@inner
def fill_regressors(memory: Memory, orders: Orders, scratch: Scratch) -> None:
    """Fill h and h_f from the channels: lags of -y, of the inputs, of the residual."""
    q = 0
    sign = -1.0
    for c in range(len(orders)):
        for i in range(orders[c]):
            scratch.h[q] = sign * memory.raw[c, i]
            scratch.hf[q] = sign * memory.filtered[c, i]
            q += 1
        sign = 1.0


@inner
def look_back(memory: Memory, h: Floats, y: float, residual: float) -> float:
    """Y minus the prediction of the map of some samples before; at first the residual."""
    early, monitor = memory.early, memory.monitor
    ns = len(early)
    if monitor[DETERMINED] > 0.0 and monitor[COUNT] % EARLIER == 0.0:
        for j in range(ns):
            early[j] = memory.theta[j]
    predicted = dot(h, early, ns)
    return residual if np.isnan(predicted) else y - predicted
