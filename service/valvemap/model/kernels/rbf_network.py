"""Loops of the gradient radial basis network, eqs. (30)-(38), one sample after another."""

import math

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel, spliced
from valvemap.model.kernels.residual_spread import EARLIER
from valvemap.model.samples import Codes, Floats, Segments

# Elements of ``monitor``.
COUNT, POWER = range(2)
MONITORS = 2

# Statuses, as in valvemap.vocabulary.statuses.Status.
OK, WARMING_UP, HELD = 0, 1, 5

LARGEST = 1e3  # in units of the ranges; larger samples are rejected
WEIGHT_BOUND = 1e3
CENTRE_BOUND = 1.0  # distance from the ranges that a centre is limited to, in ranges
LOG_WIDTH_BOUNDS = (-3.9, 1.1)  # b from 0.02 to 3 ranges
FADING = 1e-3


@kernel
def update(
    y: Floats,
    x: Floats,
    eta: float,
    alpha: float,
    w: Floats,
    c: Floats,
    log_b: Floats,
    dw: Floats,
    dc: Floats,
    dlog_b: Floats,
    monitor: Floats,
    noted: Floats,
    predicted: Floats,
    early: Floats,
    status: Codes,
    segments: Segments,
) -> None:
    """Update many networks with their samples; the states' arrays have a leading axis M."""
    members, starts, stops = segments
    neurons = w.shape[1]
    H, distance, narrow = np.empty(neurons), np.empty(neurons), np.empty(neurons)
    for s in range(len(members)):
        m = members[s]
        _train(
            y, x, eta, alpha, w[m], c[m], log_b[m], dw[m], dc[m], dlog_b[m], monitor[m],
            noted[m], predicted, early, status, H, distance, narrow, starts[s], stops[s],
        )  # fmt: skip


@spliced
def _train(
    y: Floats,
    x: Floats,
    eta: float,
    alpha: float,
    w: Floats,
    c: Floats,
    log_b: Floats,
    dw: Floats,
    dc: Floats,
    dlog_b: Floats,
    monitor: Floats,
    noted: Floats,
    predicted: Floats,
    early: Floats,
    status: Codes,
    H: Floats,
    distance: Floats,
    narrow: Floats,
    start: int,
    stop: int,
) -> None:
    """Train one network with samples start … stop - 1, in place.

    The step is eta/(1 + eta·S/(1 - alpha)), S the squared gradient: to first order the error of
    the same sample then never changes its sign, for any eta, alpha and weights.
    """
    m = len(w)
    low, high = LOG_WIDTH_BOUNDS
    for t in range(start, stop):
        early[t] = np.nan
        if not (abs(y[t]) < LARGEST and abs(x[t, 0]) < LARGEST and abs(x[t, 1]) < LARGEST):
            predicted[t] = np.nan
            status[t] = HELD
            continue
        guess = 0.0
        S = 0.0
        for j in range(m):
            r0 = x[t, 0] - c[j, 0]
            r1 = x[t, 1] - c[j, 1]
            narrow[j] = math.exp(-2.0 * log_b[j])
            z = (r0 * r0 + r1 * r1) * narrow[j]  # ‖x - c‖²/b²
            H[j] = math.exp(-0.5 * z)  # eq. (30)
            distance[j] = z
            guess += w[j] * H[j]  # eq. (31)
            g = w[j] * H[j]
            S += H[j] * H[j] + g * g * z * (z + narrow[j])
        error = y[t] - guess
        if monitor[COUNT] % EARLIER == 0.0:
            _note(w, c, log_b, noted)
        early[t] = y[t] - _told(noted, x[t, 0], x[t, 1])
        predicted[t] = guess if monitor[COUNT] > 0.0 else np.nan
        step = eta * error / (1.0 + eta * S / (1.0 - alpha))
        for j in range(m):
            g = w[j] * H[j]  # before the update, as is every gradient here
            for i in range(2):  # eqs. (37) with H_j, (38) with eta once
                old = c[j, i]
                new = old + step * g * (x[t, i] - old) * narrow[j] + alpha * dc[j, i]
                c[j, i] = min(max(new, -CENTRE_BOUND), 1.0 + CENTRE_BOUND)
                dc[j, i] = c[j, i] - old
            old = log_b[j]  # eqs. (35), (36) for log b: b stays positive
            new = old + step * g * distance[j] + alpha * dlog_b[j]
            log_b[j] = min(max(new, low), high)
            dlog_b[j] = log_b[j] - old
            old = w[j]  # eqs. (33), (34)
            new = old + step * H[j] + alpha * dw[j]
            w[j] = min(max(new, -WEIGHT_BOUND), WEIGHT_BOUND)
            dw[j] = w[j] - old
        monitor[COUNT] += 1.0
        monitor[POWER] += max(FADING, 1.0 / monitor[COUNT]) * (error * error - monitor[POWER])
        status[t] = WARMING_UP if monitor[COUNT] < 4 * m else OK


@inner
def _note(w: Floats, c: Floats, log_b: Floats, noted: Floats) -> None:
    """Write weight, centre and 1/width² of each neuron."""
    for j in range(len(w)):
        noted[j, 0], noted[j, 1], noted[j, 2] = w[j], c[j, 0], c[j, 1]
        noted[j, 3] = math.exp(-2.0 * log_b[j])


@inner
def _told(noted: Floats, x0: float, x1: float) -> float:
    """Output of the copied network, eqs. (30), (31)."""
    total = 0.0
    for j in range(len(noted)):
        r0, r1 = x0 - noted[j, 1], x1 - noted[j, 2]
        total += noted[j, 0] * math.exp(-0.5 * (r0 * r0 + r1 * r1) * noted[j, 3])
    return total


@kernel
def evaluate(
    x: Floats,
    w: Floats,
    c: Floats,
    log_b: Floats,
) -> Floats:
    """Output of the network at N points, eqs. (30), (31)."""
    noted, mean = np.empty((len(w), 4)), np.empty(len(x))
    _note(w, c, log_b, noted)
    for t in range(len(x)):
        mean[t] = _told(noted, x[t, 0], x[t, 1])
    return mean
