"""The balance of forces at a piston as band-passed rows of a regression, in fixed order.

Columns: dry friction's course s(v), speed v, acceleration; the response is the force of both
pressures. All pass the same low-pass of 2nd order and two high-passes. Acceleration is the
difference of the low-passed speed; the other columns are taken in the middle of it.
"""

import math
from typing import Final

import numpy as np

from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.samples import Floats

COLUMNS: Final = 3  # dry friction, speed, acceleration
SCORES: Final = ("running", "blocks", "rows", "length")
"""Of the column of dry friction: the running block's sum, Σ of its squares, that of single rows."""
STATIC_SHARE: Final = 0.5  # of dry friction: more of it near a standstill (Stribeck)
STATIC_SPEED: Final = 10.0  # times the speed of the transition: where that has gone
FREEDOM: Final = 10.0  # of the rows' Student distribution: a load may jump
KNOWN, FORCE, SPEED, SETTLING, PHASE, FILTERS = range(6)
MEMORY: Final = FILTERS + 2 * COLUMNS + 2 * (COLUMNS + 1)


@inner
def friction_course(v: float, transition: float) -> float:
    """Return dry friction at the speed v over that of sliding, of either sign."""
    static = math.exp(-((v / (STATIC_SPEED * transition)) ** 2))
    return math.tanh(v / transition) * (1.0 + STATIC_SHARE * static)


@kernel
def force_rows(
    force: Floats,
    speed: Floats,
    settings: Floats,
    theta: Floats,
    memory: Floats,
    M: Floats,
    b: Floats,
    squares: Floats,
    scores: Floats,
) -> None:
    """Advance the sums of the balance of forces by N samples.

    Parameters
    ----------
    force, speed
        Of the pressures (N), and of the piston over the interval before (m/s), (N,). NaN: the
        interval is left out.
    settings
        Sampling period (s), speed of friction's transition (m/s), shares per sample of the speed's
        smoothing, of the low-pass and of the high-passes; intervals until filters have settled;
        stride; rows in a block; the rows' σ (N), 0: all count alike.
    theta
        Coefficients (3,) for the rows' residuals.
    memory
        ``MEMORY`` numbers.
    M, b, squares, scores
        Sums (3, 3), (3,); Σw·y², Σw and the number of rows (3,); ``SCORES``.
    """
    period, transition, smooth = settings[0], settings[1], settings[2]
    low, high = settings[3], settings[4]
    sigma, at = settings[8], FILTERS
    values, rows = np.zeros(COLUMNS), np.zeros(COLUMNS + 1)
    for i in range(len(force)):
        if not (math.isfinite(speed[i]) and math.isfinite(force[i])):
            memory[KNOWN] = 0.0
            continue
        if memory[KNOWN] == 0.0:
            for k in range(MEMORY):
                memory[k] = 0.0
            memory[KNOWN], memory[SETTLING] = 1.0, settings[5]
            memory[FORCE], memory[SPEED] = force[i], speed[i]
            memory[at + 4] = memory[at + 5] = force[i]  # else its mean would take long to fade
            memory[at + 4 * COLUMNS] = force[i]
            continue
        mean = 0.5 * (force[i] + memory[FORCE])
        memory[FORCE] = force[i]
        memory[SPEED] += smooth * (speed[i] - memory[SPEED])
        course = friction_course(memory[SPEED], transition)
        values[0], values[1], values[2] = course, speed[i], mean
        for column in range(COLUMNS):
            first, second = at + 2 * column, at + 2 * column + 1
            before = memory[second]
            memory[first] += low * (values[column] - memory[first])
            memory[second] += low * (memory[first] - before)
            rows[column if column < 2 else COLUMNS] = 0.5 * (memory[second] + before)
            if column == 1:
                rows[2] = (memory[second] - before) / period
        for column in range(COLUMNS + 1):
            place = at + 2 * COLUMNS + 2 * column
            for stage in range(2):
                memory[place + stage] += high * (rows[column] - memory[place + stage])
                rows[column] -= memory[place + stage]
        if memory[SETTLING] > 0.0:
            memory[SETTLING] -= 1.0
            continue
        memory[PHASE] += 1.0
        if memory[PHASE] < settings[6]:
            continue
        memory[PHASE] = 0.0
        e = rows[3]
        for j in range(COLUMNS):
            e -= theta[j] * rows[j]
        weight = 1.0
        if sigma > 0.0:
            weight = (FREEDOM + 1.0) / (FREEDOM + e * e / (sigma * sigma))
        for j in range(COLUMNS):
            b[j] += weight * rows[j] * rows[3]
            for k in range(COLUMNS):
                M[j, k] += weight * rows[j] * rows[k]
        squares[0] += weight * rows[3] * rows[3]
        squares[1] += weight
        squares[2] += 1.0
        score = weight * e * rows[0]
        scores[0] += score
        scores[2] += score * score
        scores[3] += 1.0
        if scores[3] >= settings[7]:
            scores[1] += scores[0] * scores[0]
            scores[0] = 0.0
            scores[3] = 0.0
