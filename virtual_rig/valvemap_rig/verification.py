"""Points of the true map, to verify an identified one."""

from typing import NamedTuple

import numpy as np

from valvemap_rig.circuit import reachable, tank_temperature, true_flow
from valvemap_rig.condition import AS_NEW, Condition
from valvemap_rig.excitation import (
    low_discrepancy_points,
)
from valvemap_rig.records import Floats
from valvemap_rig.scenario import Scenario, ScenarioError


class VerificationPoints(NamedTuple):
    """Noise-free points of one valve, all arrays of shape (N,): %, bar, °C, l/min."""

    U: Floats
    dp: Floats
    T: Floats
    Q: Floats


def verification_points(
    scenario: Scenario, valve: str | None = None, n: int = 1000, worn: Condition = AS_NEW
) -> VerificationPoints:
    """Return the reachable ones of n points spread evenly over the map, with their true flow.

    They are the points of the ``verification`` excitation that the new valve can reach at the
    tank's set temperature. The true flow is that of the valve and oil in the condition ``worn``.
    ``valve`` defaults to the first one.

    Raises
    ------
    ScenarioError
        if there is no such valve.

    Examples
    --------
    >>> from valvemap_rig.scenario import BUILTIN
    >>> points = verification_points(BUILTIN["demo"])
    >>> 700 < len(points.Q) < 900
    True
    """
    benches = {bench.name: bench for bench in scenario.valves}
    if not benches or (valve is not None and valve not in benches):
        allowed = f"allowed are {', '.join(benches)}" if benches else "there are only machines"
        raise ScenarioError(f"{valve or scenario.name}: no such valve; {allowed}")
    bench = scenario.valves[0] if valve is None else benches[valve]
    U, dp = low_discrepancy_points(np.arange(n), bench.circuit.p0_bar)
    T = tank_temperature(bench.circuit, np.zeros(n))
    inside = reachable(bench, U, dp, T)
    U, dp, T = U[inside], dp[inside], T[inside]
    T = T + worn.temperature_rise
    return VerificationPoints(U, dp, T, true_flow(bench, U, dp, T, worn))
