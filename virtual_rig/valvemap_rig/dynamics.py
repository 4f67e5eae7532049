"""Elements with memory: hysteresis and first-order lag, as loops in fixed order.

A memory of NaN means none: the element then starts in equilibrium with the first sample.
"""

import math

import numba
import numpy as np

from valvemap_rig.records import Floats


def play(u: Floats, width: float, memory: float) -> Floats:
    """Apply the play operator: y follows u with hysteresis, |y - u| ≤ width/2.

    >>> play(np.array([0.0, 2.0, 1.5, 0.0]), 1.0, float("nan"))
    array([0. , 1.5, 1.5, 0.5])
    """
    return np.asarray(_play(np.ascontiguousarray(u), 0.5 * width, memory))


def lag(u: Floats, time_constant: float, period: float, memory: float) -> Floats:
    """Apply a first-order lag, exact for a signal that is constant over each period.

    >>> lag(np.array([0.0, 1.0, 1.0]), 1.0, 1.0, float("nan")).round(3)
    array([0.   , 0.632, 0.865])
    """
    if time_constant == 0.0:
        return u
    step = -math.expm1(-period / time_constant)
    return np.asarray(_lag(np.ascontiguousarray(u), step, memory))


def changing_lag(u: Floats, time_constants: Floats, period: float, memory: float) -> Floats:
    """Apply a first-order lag with a time constant per sample; 0 means no lag.

    >>> changing_lag(np.array([0.0, 1.0, 1.0]), np.array([0.0, 1.0, 0.0]), 1.0, 0.0).round(3)
    array([0.   , 0.632, 1.   ])
    """
    found, which = np.unique(time_constants, return_inverse=True)
    steps = np.array([-math.expm1(-period / x) if x else 1.0 for x in found.tolist()])[which]
    return np.asarray(_changing_lag(np.ascontiguousarray(u), steps, memory))


def second_order(
    u: Floats, hz: Floats, damping: float, period: float, memory: tuple[float, float]
) -> tuple[Floats, tuple[float, float]]:
    """Apply x'' = ω²·(u - x) - 2ζω·x'; return x at each sample, and (x, x') before the next.

    ``u`` is constant from its sample to the next; ``hz`` is the natural frequency there.

    >>> x, _ = second_order(np.array([0.0, 1.0, 1.0]), np.full(3, 5.0), 0.7, 0.1, (0.0, 0.0))
    >>> x.round(2)
    array([0.  , 0.  , 0.98])
    """
    x = np.empty_like(u)
    memory = _second_order(np.ascontiguousarray(u), hz, damping, period, *memory, x)
    return x, memory


@numba.njit(cache=True)
def _second_order(
    u: Floats, hz: Floats, damping: float, period: float, x: float, v: float, out: Floats
) -> tuple[float, float]:
    for i in range(u.size):
        if math.isnan(x):
            x, v = u[i], 0.0
        out[i] = x
        w = 2.0 * math.pi * hz[i]
        steps = max(1, math.ceil(100.0 * period * hz[i]))
        h = period / steps
        for _ in range(steps):  # the midpoint's acceleration
            a = w * w * (u[i] - x) - 2.0 * damping * w * v
            middle = w * w * (u[i] - x - 0.5 * h * v) - 2.0 * damping * w * (v + 0.5 * h * a)
            x, v = x + h * v + 0.5 * h * h * a, v + h * middle
    return x, v


@numba.njit(cache=True)
def _changing_lag(u: Floats, steps: Floats, memory: float) -> Floats:
    y = np.empty_like(u)
    for i in range(u.size):
        if steps[i] == 1.0 or math.isnan(memory):
            memory = u[i]
        memory += steps[i] * (u[i] - memory)
        y[i] = memory
    return y


@numba.njit(cache=True)
def _play(u: Floats, half: float, memory: float) -> Floats:
    y = np.empty_like(u)
    for i in range(u.size):
        if math.isnan(memory):
            memory = u[i]
        memory = min(max(memory, u[i] - half), u[i] + half)
        y[i] = memory
    return y


@numba.njit(cache=True)
def _lag(u: Floats, step: float, memory: float) -> Floats:
    y = np.empty_like(u)
    for i in range(u.size):
        if math.isnan(memory):
            memory = u[i]
        memory += step * (u[i] - memory)
        y[i] = memory
    return y
