"""Possible causes of a residual: which regressors explain most of it."""

import numpy as np

from valvemap.model.kernels.compiled import inlined, lean_kernel
from valvemap.model.samples import Floats, Times
from valvemap.pipeline.kernels.alarm_layout import (
    CAUSES,
    DIRECTIONS,
    Q_BEFORE,
    T_USUAL,
    Conditions,
    Senses,
    Watched,
)
from valvemap.vocabulary.signals import Signal

CAUSE_MEMORY = 1.0 - 1.0 / 1000.0  # per sample; memory of the sums that distinguish causes
HALF_FORGOTTEN = 0.5  # factor of the sums at such a block: older samples blur a new cause
LEAST_DP = 1.0  # bar; lower bound of dp in Q̂/dp

# Regressors of the causes in the residual: 1, √dp, Q̂, Q̂/dp, dQ̂/dt.
CONSTANT, ROOT_DP, FLOW, FLOW_BY_DP, FLOW_RATE = range(DIRECTIONS)

# Possible causes, numbered as `pipeline.alarm_words.Cause`.
NO_CAUSE, EDGE, METER, SIGNAL, LAG, HOT_OIL = range(CAUSES)
TELLING = 0.15  # share of the squares; causes whose shares differ by less are equivalent
RULED_OUT = 4.0  # times the part that the best cause leaves unexplained; more excludes a cause
LEFT = 0.1  # share of the squares that no cause explains: noise
CLEAR = 0.1  # share that a lag must explain beyond the others: a constant error resembles one
LEAST_SHARE = 1e-6  # least share of an edge, a meter and an offset: always possible
OTHER_OIL_K = 3.0  # K from the usual temperature, beyond which the oil is named first

_P1, _P2 = int(Signal.P1), int(Signal.P2)


@lean_kernel
def name_causes(
    valves: Times, alarm: int, conditions: Conditions, senses: Senses, shares: Floats
) -> None:
    """Write the possible causes for K valves: up to three that explain most of the residual.

    A cause that explains it nearly as well as the best cannot be distinguished from it. ``shares``
    (CAUSES,) is a scratch array.
    """
    for k in range(len(valves)):
        write_causes(valves[k], alarm, conditions, senses, shares)


@inlined
def write_causes(
    m: int, alarm: int, conditions: Conditions, senses: Senses, shares: Floats
) -> None:
    """Write the possible causes for one valve."""
    sums, causes = senses.sums[m], conditions.causes[m, alarm]
    shares[:] = 0.0
    shares[EDGE] = _explained(sums, FLOW, ROOT_DP)
    shares[METER] = _explained(sums, FLOW, CONSTANT)
    shares[SIGNAL] = _explained(sums, ROOT_DP, FLOW_BY_DP)
    shares[LAG] = _explained(sums, FLOW_RATE, FLOW_RATE)
    if abs(shares[EDGE] - shares[METER]) < TELLING:  # 5 % less flow is 5 % less shown
        shares[EDGE] = shares[METER] = max(shares[EDGE], shares[METER], LEAST_SHARE)
    shares[SIGNAL] = max(shares[SIGNAL], LEAST_SHARE)
    if shares[LAG] < CLEAR + max(shares[EDGE], shares[METER], shares[SIGNAL]):
        shares[LAG] = 0.0
    if abs(senses.last[m, 4] - senses.memory[m, T_USUAL]) > OTHER_OIL_K:
        shares[HOT_OIL] = 2.0
    causes[:] = NO_CAUSE
    best = 0.0
    for place in range(len(causes)):
        chosen = NO_CAUSE
        for cause in range(1, CAUSES):
            if shares[cause] > shares[chosen]:
                chosen = cause
        share = min(shares[chosen], 1.0)
        if chosen == NO_CAUSE or (place > 0 and 1.0 - share > LEFT + RULED_OUT * (1.0 - best)):
            return
        best = share if shares[chosen] <= 1.0 and best == 0.0 else best
        causes[place] = chosen
        shares[chosen] = 0.0


@inlined
def _explained(sums: Floats, j: int, k: int) -> float:
    """Share of the residual's squares explained by two regressors together."""
    e, squares = DIRECTIONS, sums[DIRECTIONS, DIRECTIONS]
    if not squares > 0.0:
        return 0.0
    first = sums[j, e] ** 2 / sums[j, j] if sums[j, j] > 0.0 else 0.0
    second = sums[k, e] ** 2 / sums[k, k] if sums[k, k] > 0.0 else 0.0
    determinant = sums[j, j] * sums[k, k] - sums[j, k] ** 2
    if determinant <= 1e-9 * sums[j, j] * sums[k, k]:
        return float(max(first, second) / squares)
    both = sums[j, e] ** 2 * sums[k, k] + sums[k, e] ** 2 * sums[j, j]
    both -= 2.0 * sums[j, e] * sums[k, e] * sums[j, k]
    return float(both / determinant / squares)


@inlined
def add_up(m: int, i: int, seen: Watched, senses: Senses) -> None:
    """Add a sample to the sums of products of the regressors and the residual."""
    memory, sums = senses.memory[m], senses.sums[m]
    e, Q, dp = seen.residual[i], seen.predicted[i], seen.values[i, _P1] - seen.values[i, _P2]
    rate = Q - memory[Q_BEFORE] if np.isfinite(memory[Q_BEFORE]) else 0.0
    row = (1.0, np.sqrt(max(dp, 0.0)), Q, Q / max(dp, LEAST_DP), rate, e)
    for j in range(DIRECTIONS + 1):
        for k in range(DIRECTIONS + 1):
            sums[j, k] = CAUSE_MEMORY * sums[j, k] + row[j] * row[k]


@inlined
def forget_half(m: int, senses: Senses) -> None:
    """Halve the sums of one valve: older samples would blur a new cause."""
    for j in range(DIRECTIONS + 1):
        for k in range(DIRECTIONS + 1):
            senses.sums[m, j, k] *= HALF_FORGOTTEN
