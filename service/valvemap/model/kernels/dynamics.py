"""Spool and flow meter in small steps: regressors of the flow map behind both.

    x'' = ω²·(U(t - d) - x) - 2ζω·x',  |x'| ≤ slew        spool
    τ·y' + y = φ(x)·ψ(Δp)                                  meter, one column per product

A step of length h is exact for the spool without its limit, and for the meter. Where the limit is
reached within a step, the speed is a line up to it, then constant.
"""

import math

from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.samples import Floats

SHARP, SOFT = 0.05, 0.25  # of the largest √Δp; where two of its functions bend


@inner
def _add(
    X: Floats, k: int, x: float, s: float, weight: float, low: float, width: float, parts: int
) -> None:
    """Add the products of the B-splines of x with the functions of s, which belong to one step."""
    place = min(max((x - low) / width, 0.0), parts - 1e-9)
    j = int(place)
    z = place - j
    many, size = parts + 2, abs(s)
    first, last = 0.5 * (1.0 - z) ** 2, 0.5 * z * z
    sharp, soft = s / (size + SHARP), s / (size + SOFT)
    for i, b in enumerate((first, 1.0 - first - last, last)):
        share = weight * b
        X[k, j + i] += share * s
        X[k, many + j + i] += share * s * size
        X[k, 2 * many + j + i] += share * sharp
        X[k, 3 * many + j + i] += share * soft


@inner
def _ahead(moved: float, v: float, speed: float, slew: float) -> float:
    """Return the way of one step: without a limit ``moved``, from speed ``v`` to ``speed``."""
    if abs(speed) <= slew:
        return moved
    most = math.copysign(slew, speed)
    share = (most - v) / (speed - v)  # of the step, below the limit: |v| is within it
    return share * 0.5 * (v + most) + (1.0 - share) * most


@lean_kernel
def regressors(
    U: Floats,
    s: Floats,
    P: Floats,
    slew: float,
    left: float,
    low: float,
    width: float,
    parts: int,
    steps: int,
    X: Floats,
) -> None:
    """Write the meter's columns at N samples into ``X`` (N, 4·(parts + 2)).

    Parameters
    ----------
    U : (N·steps,)
        Mean command of each step, dead time included, %.
    s : (N,)
        √Δp with its sign, over the largest one.
    P : (4,)
        Transition over a step of (x - U, x'), by rows.
    slew
        Largest |x'| over a step, in % per step.
    left
        exp(-h/τ) of the meter, 0 without lag.
    low, width
        First knot of the quadratic B-splines in x, and their distance, %.
    """
    columns = X.shape[1]
    x, v = U[0], 0.0
    for k in range(len(s)):
        if k == 0:  # at rest before the first sample
            _add(X, 0, x, s[0], 1.0, low, width, parts)
            continue
        for j in range(columns):
            X[k, j] = X[k - 1, j] * left**steps
        for i in range(steps):
            u = U[(k - 1) * steps + i]
            e = x - u
            before = x
            speed = P[2] * e + P[3] * v
            x = before + _ahead(P[0] * e + P[1] * v - e, v, speed, slew)
            v = min(max(speed, -slew), slew)
            share = (i + 0.5) / steps
            drop = s[k - 1] + share * (s[k] - s[k - 1])
            weight = (1.0 - left) * left ** (steps - 1 - i)
            if weight > 0.0:
                _add(X, k, 0.5 * (before + x), drop, weight, low, width, parts)


@lean_kernel
def behind(U: Floats, half: float, x: Floats) -> None:
    """Write U behind a play of twice ``half`` into ``x``, %; both (N,)."""
    at = U[0]
    for k in range(len(U)):
        at = min(max(at, U[k] - half), U[k] + half)
        x[k] = at


@lean_kernel
def spool(U: Floats, P: Floats, slew: float, x: Floats) -> None:
    """Write the spool's position after each step into ``x``, from rest at 0."""
    at, v = 0.0, 0.0
    for k in range(len(U)):
        e = at - U[k]
        speed = P[2] * e + P[3] * v
        at += _ahead(P[0] * e + P[1] * v - e, v, speed, slew)
        v = min(max(speed, -slew), slew)
        x[k] = at
