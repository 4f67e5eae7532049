"""What follows where the recursion of maximum likelihood has diverged."""

from valvemap.model.kernels import filtered_scores
from valvemap.model.kernels.compiled import inner
from valvemap.model.kernels.likelihood_memory import (
    COUNT,
    LARGEST_RESULT,
    OUTPUT_POWER,
    PATIENCE,
    POWER,
    RAMP,
    RAMP_START,
    RESTARTS,
    RLS_POWER,
    ROUNDING,
    SINCE,
    TOO_BAD,
    VARIANCE,
    Memory,
)
from valvemap.model.samples import Codes, Floats
from valvemap.vocabulary.statuses import Status

_HELD = int(Status.HELD)


@inner
def recover(memory: Memory, after: float, status: Codes, t: int) -> None:
    """Restart from plain RLS if RML has diverged, or from the initial state if both have."""
    monitor, nd = memory.monitor, len(memory.theta) - len(memory.rls_theta)
    total = abs(after) + abs(memory.filtered[len(memory.filtered) - 1, 0]) + monitor[VARIANCE]
    for j in range(len(memory.theta)):
        total += abs(memory.theta[j]) + memory.factor[j, j] + memory.spread[j, j]
    for j in range(len(memory.rls_theta)):
        total += abs(memory.rls_theta[j]) + memory.rls_factor[j, j]
    if not total < LARGEST_RESULT:  # also for NaN
        status[t] = _HELD
        memory.raw[:] = 0.0
        memory.rls_theta[:] = 0.0
        memory.rls_factor[:] = 0.0
        for j in range(len(memory.rls_theta)):
            memory.rls_factor[j, j] = memory.prior[j]
        _restart(memory)
    elif (
        nd > 0
        and monitor[SINCE] > PATIENCE
        and monitor[POWER]
        > TOO_BAD * monitor[RLS_POWER] + (1e3 * ROUNDING) ** 2 * monitor[OUTPUT_POWER]
    ):
        _restart(memory)


@inner
def _restart(memory: Memory) -> None:
    """Copy theta and P of plain RLS, without a noise model."""
    ns, monitor = len(memory.rls_theta), memory.monitor
    restarts = monitor[RESTARTS] + 1.0
    count = monitor[COUNT]
    monitor[:] = 0.0
    monitor[RESTARTS] = restarts
    monitor[COUNT] = count
    monitor[RAMP] = RAMP_START if ns < len(memory.theta) else 1.0
    filtered_scores.forget(memory.omega, memory.moments, memory.blocks, memory.colour)
    memory.theta[:] = 0.0
    memory.factor[:] = 0.0
    memory.spread[:] = 0.0
    for j in range(ns, len(memory.theta)):
        memory.prior[j] = 0.0
    for j in range(ns):
        memory.theta[j] = memory.rls_theta[j]
        for i in range(j + 1):
            memory.factor[j, i] = memory.rls_factor[j, i]
    for i in range(memory.raw.shape[1]):
        memory.raw[len(memory.raw) - 1, i] = 0.0
    _take(memory.filtered, memory.raw)


@inner
def _take(to: Floats, values: Floats) -> None:
    """Copy a matrix; ``to[:] = values`` takes numba five seconds to compile."""
    for i in range(to.shape[0]):
        for j in range(to.shape[1]):
            to[i, j] = values[i, j]
