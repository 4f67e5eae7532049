"""One alarm is judged by its quantity: activation and deactivation, with delay and hysteresis."""

import numpy as np

from valvemap.model.kernels.compiled import inlined, lean_kernel
from valvemap.model.samples import Flags, Floats, Times
from valvemap.pipeline.kernels.alarm_layout import Conditions


@lean_kernel
def move_on(
    valves: Times,
    t: Times,
    began: Times,
    x: Floats,
    alarm: int,
    rules: Floats,
    conditions: Conditions,
    came: Flags,
) -> None:
    """Judge one alarm of K valves by its quantity ``x`` (K,); set ``came`` (K,) on activation."""
    for k in range(len(valves)):
        came[k] = step(valves[k], alarm, t[k], began[k], x[k], rules, conditions)


@inlined
def step(
    m: int, a: int, t: int, began: int, x: float, rules: Floats, conditions: Conditions
) -> bool:
    """Judge one alarm; True if it is activated now. NaN changes nothing."""
    limit, release, delay = rules[a, 0], rules[a, 1], rules[a, 2]
    if np.isnan(x):
        return False
    if conditions.active[m, a]:
        conditions.value[m, a] = max(conditions.value[m, a], x)
        if x < release or (x <= limit and release == limit):
            conditions.active[m, a] = False
            conditions.over[m, a] = 0
            conditions.at[m, a] = max(t, conditions.at[m, a])
            conditions.version[m] += 1
        return False
    if not x > limit:
        conditions.over[m, a] = 0
        return False
    if conditions.over[m, a] == 0:
        conditions.over[m, a] = began
        conditions.value[m, a] = x
    conditions.value[m, a] = max(conditions.value[m, a], x)
    if t - conditions.over[m, a] < delay:
        return False
    conditions.active[m, a] = True
    conditions.acked[m, a] = False
    conditions.since[m, a] = conditions.over[m, a]
    conditions.at[m, a] = max(t, conditions.at[m, a])
    conditions.came[m, a] += 1
    conditions.version[m] += 1
    return True
