"""Stated errors of exported tables beside the largest at 10⁶ points.

`python -m benchmarks.table_errors`; a valve with a dead band of 6 %, and one that saturates
(`--valves saturating` for it alone), learnt from 5,000 samples between 25 and 55 °C. The
figures stand in docs/methods/models.md.
"""

import argparse
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from valvemap.model.flow_map import FlowMap
from valvemap.model.flow_table import flow_table
from valvemap.model.inverse_map import invert
from valvemap.model.lookup_table import lookup_table, place
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.model.support import Support
from valvemap.model.tensor_spline import TensorSpline
from valvemap.model.valve_tables import valve_tables
from valvemap.vocabulary.statuses import InverseStatus

POINTS, N, T = 1_000_000, 5_000, 40.0
DELIVERED: Final = (InverseStatus.OK, InverseStatus.UNCERTAIN)  # U is the exact inverse of the map


VALVES: Final[Mapping[str, Callable[[np.ndarray], np.ndarray]]] = {
    "dead band": lambda U: 2.0 * np.clip(U - 6.0, 0, 90),
    "saturating": lambda U: 127.0 * np.tanh(U / 45.0),
}
"""Flow at 200 bar and 40 °C, l/min, of U in %."""


def figures(
    estimator: Any, opened: Callable[[np.ndarray], np.ndarray]
) -> dict[str, tuple[float, float]]:
    """Stated and largest error of each table: U in %, flows in l/min."""
    rng = np.random.default_rng(4)
    U, dp, oil = rng.uniform(0, 100, N), rng.uniform(1, 200, N), np.linspace(25.0, 55.0, N)
    Q = opened(U) * np.sqrt(dp / 200) * (1.0 + 0.004 * (oil - T))
    samples = Samples.of(np.arange(N), U, dp, 0 * dp, Q + 0.3 * rng.normal(size=N), oil)
    state, _ = estimator.update(estimator.initial_state(), samples)
    inverse = lookup_table(estimator, state, T=T)
    flows = flow_table(estimator, state, inverse)
    forward = valve_tables(estimator, state, inverse, Support.none(), 0.3).forward

    def flow(at_U: np.ndarray, at_dp: np.ndarray) -> np.ndarray:
        return np.asarray(estimator.predict(state, at_U, at_dp, np.full(len(at_U), T))[0])

    dp = rng.uniform(inverse.dp[0], inverse.dp[-1], POINTS)
    low, high = (np.interp(dp, inverse.dp, x) for x in (inverse.lowest, inverse.highest))
    beside = rng.uniform(size=POINTS) ** 4  # dense where a dead band ends
    r = np.where(rng.uniform(size=POINTS) < 0.5, beside, rng.uniform(-0.02, 1.02, POINTS))
    ends = rng.integers(0, 2, POINTS) + rng.uniform(-1e-3, 1e-3, POINTS)  # beside both limits
    r = np.where(rng.uniform(size=POINTS) < 0.25, ends, r)
    Q = low + r * (high - low)
    U, exact = inverse.interpolate(Q, dp)[0], invert(estimator, state, Q, dp, T)
    both, within = np.isfinite(U), np.isfinite(U) & np.isin(exact.status, DELIVERED)
    delivered = flow(U[both], dp[both]) - np.clip(Q, low, high)[both]
    demand = rng.uniform(flows.Q[0], flows.Q[-1], POINTS)
    shut, open_ = (flow(np.full(POINTS, end), dp) for end in (0.0, 100.0))
    demand = np.where(rng.uniform(size=POINTS) < 0.5, shut + beside * (open_ - shut), demand)
    demand = np.clip(demand, flows.Q[0], flows.Q[-1])
    sheet, wanted = flows.interpolate(demand, dp), invert(estimator, state, demand, dp, T).U
    known = np.isfinite(sheet) & np.isfinite(wanted)
    at_U, at_s = rng.uniform(0, 100, POINTS), rng.uniform(0, forward.s[-1], POINTS)
    (i, u), (j, v) = place(forward.U, at_U), place(forward.s, at_s)
    low_U, high_U = ((1 - v) * forward.Q[k, j] + v * forward.Q[k, j + 1] for k in (i, i + 1))
    of_sheet = flow(sheet[known], dp[known]) - flow(wanted[known], dp[known])
    pairs = {
        "C, ST: U": (inverse.error_U, (U - exact.U)[within]),
        "C, ST: flow": (inverse.error_Q, delivered),
        "CSV: U": (flows.error_U, sheet[known] - wanted[known]),
        "CSV: flow": (flows.error_Q, of_sheet),
        "FMU: flow": (forward.error, (1 - u) * low_U + u * high_U - flow(at_U, at_s**2)),
    }
    return {name: (stated, float(np.abs(x).max())) for name, (stated, x) in pairs.items()}


def main() -> None:
    """Print a row per map."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--valves", nargs="+", choices=VALVES, default=list(VALVES))
    for valve in parser.parse_args().valves:
        for name, estimator in (
            ("eq. (7)", RecursiveLeastSquares()),
            ("spline, 63 parameters", RecursiveLeastSquares(TensorSpline.uniform(6, 4))),
            ("RBF network", RbfNetwork()),
            ("`Auto`", FlowMap()),
        ):
            found = figures(estimator, VALVES[valve])
            cells = (f"{stated:.3g} / {largest:.3g}" for stated, largest in found.values())
            print(f"| {valve}, {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
