"""How well `Auto` finds lags: ``python -m benchmarks.lag [SEEDS SAMPLES]``.

A line per pair of lags: the lags found, the map's RMSE in σ inside the data, the share of the true
Q covered by its 95 % interval, and the loop claimed (there is none).
"""

import sys
from collections.abc import Sequence
from typing import Final

import numpy as np

from benchmarks.auto_speed import SIGMA, START, ramps_and_holds
from benchmarks.measured_data import Floats
from service.identification.auto import Auto
from service.identification.map_shapes import Shape
from service.identification.samples import Samples

PAIRS: Final = (  # of U's effect, of the meter, s
    *((0.0, tau) for tau in (0.0, 0.05, 0.2, 0.3)),
    *((tau, 0.0) for tau in (0.05, 0.1)),
    *((0.05, 0.05), (0.1, 0.2), (0.03, 0.3)),
)


def valve(U: Floats, dp: Floats) -> Floats:
    """A dead band of 4 %, a slightly bent gain."""
    u = np.clip((U - 4.0) / 96.0, 0.0, 1.0)
    return np.asarray(14.0 * u * (1.15 - 0.15 * u) * np.sqrt(dp))


def lagged(x: Floats, tau: float, step: float = 0.01) -> Floats:
    """Behind a first-order lag."""
    share = 1.0 - np.exp(-step / tau) if tau > 0.0 else 1.0
    out, y = np.empty_like(x), x[0]
    for i, value in enumerate(x):
        y += share * (value - y)
        out[i] = y
    return out


def one(seed: int, N: int, tau_U: float, tau_Q: float) -> tuple[float, float, float, float, float]:
    """Lags found, s, RMSE in σ, share covered, and the loop's width, %."""
    rng = np.random.default_rng(seed)
    U, dp = ramps_and_holds(rng, N, 0.0, 100.0), ramps_and_holds(rng, N, 3.0, 195.0)
    Q = lagged(valve(lagged(U, tau_U), dp), tau_Q) + SIGMA * rng.standard_normal(N)
    t = START + 10_000_000 * np.arange(N)
    auto = Auto()
    state, _ = auto.update(auto.initial_state(), Samples.of(t, U, dp + 5.0, 0.0 * dp + 5.0, Q))
    at_U, at_dp = rng.uniform(0.0, 100.0, 500), rng.uniform(1.0, 199.0, 500)
    near = (np.abs(at_U[:, None] - U[::5]) < 5.0) & (np.abs(at_dp[:, None] - dp[::5]) < 5.0)
    inside = near.sum(axis=1) >= 3
    at_U, at_dp = at_U[inside], at_dp[inside]
    said, std = auto.predict(state, at_U, at_dp, np.full_like(at_U, 40.0))
    error = said - valve(at_U, at_dp)
    rmse = float(np.sqrt(np.mean(error**2))) / SIGMA
    covered = float(np.mean(np.abs(error) <= 1.96 * std))
    return *auto.lags(state), rmse, covered, 2.0 * Shape.from_array(state.shapes[0]).play


def main(arguments: Sequence[str]) -> int:
    """Measure and print."""
    seeds, N = map(int, arguments) if arguments else (4, 20_000)
    print("  LagU, ms  LagQ, ms           found  RMSE, σ (worst)  covered  loop, %")
    for tau_U, tau_Q in PAIRS:
        found = np.array([one(seed, N, tau_U, tau_Q) for seed in range(seeds)])
        U, Q, rmse, covered = found.mean(axis=0)[:4]
        print(
            f"{1e3 * tau_U:10.0f}{1e3 * tau_Q:10.0f}{1e3 * U:8.0f}{1e3 * Q:8.0f}"
            f"{rmse:9.2f} ({found[:, 2].max():5.2f}){covered:9.3f}{found[:, 4].max():9.2f}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
