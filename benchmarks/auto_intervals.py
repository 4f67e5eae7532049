"""What `Auto`'s intervals hold on a machine: ``python -m benchmarks.auto_intervals [SEEDS KIND]``.

A line per circumstance: the share of the true flows inside the data that the 95 % interval covers,
its mean width over that of the oracle's, the map's RMSE in σ (its worst seed), and changes found.
*Inside* is within 5 % of U and 5 bar of three samples at least. The *oracle* is generalised least
squares of the same structure, with the noise's correlation known, and the λ best in hindsight; its
width is 3.92 times the RMS of its true error inside.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.auto_speed import SIGMA, START, ramps_and_holds
from benchmarks.measured_data import Floats
from service.identification.auto import Auto, AutoState
from service.identification.map_shapes import Shape
from service.identification.model_structures import FiveTerms
from service.identification.samples import Samples

Valve = Callable[[Floats, Floats], Floats]

N, FS, POINTS, RHO, GAIN = 20_000, 100.0, 400, 0.95, 1.0
PER_HOUR: Final = -0.15
MEMORIES: Final = (300.0, 1_000.0, 3_000.0, 10_000.0, np.inf)  # samples: 1/(1 - λ) of the oracle
RIDGE: Final = 1e-6  # samples' worth: keeps the oracle's parameters determined


def dead_band(U: Floats, dp: Floats) -> Floats:
    """A dead band of 6 %, a bent gain."""
    u = np.clip((U - 6.0) / 94.0, 0.0, 1.0)
    return np.asarray(13.0 * u * (1.12 - 0.12 * u) * np.sqrt(dp))


def saturating(U: Floats, dp: Floats) -> Floats:
    """A gain that bends all the way."""
    return np.asarray(9.5 * np.tanh(U / 50.0) * np.sqrt(dp))


VALVES: Final[Mapping[str, Valve]] = {"dead band": dead_band, "saturating": saturating}
KINDS: Final = ("ideal", "coloured", "drift", "wear", "closed loop", "reacting")


@dataclass(frozen=True)
class Recording:
    """Samples of a circumstance, the valve as it is at their end, and their noise's correlation."""

    samples: Samples
    valve: Valve
    rho: float


@dataclass(frozen=True)
class Figures:
    """Of one seed: points covered, mean width and the oracle's, l/min; RMSE, σ; changes."""

    covered: NDArray[np.bool_]
    width: float
    oracle: float
    rmse: float
    changes: int


def coloured(rng: np.random.Generator, n: int, rho: float) -> Floats:
    """Stationary noise of correlation ``rho`` from sample to sample."""
    e, out, y = rng.normal(size=n) * SIGMA * np.sqrt(1 - rho**2), np.empty(n), 0.0
    for i, value in enumerate(e):
        y = rho * y + value
        out[i] = y
    return out


def closed_loop(rng: np.random.Generator, valve: Valve, dp: Floats) -> tuple[Floats, Floats]:
    """U by a PI controller of the flow, and that flow."""
    n = len(dp)
    demand, noise = ramps_and_holds(rng, n, 10.0, 120.0), SIGMA * rng.standard_normal(n)
    U, Q, integral, u = np.empty(n), np.empty(n), 0.0, 20.0
    for i in range(n):
        Q[i] = valve(np.array([u]), dp[i : i + 1])[0] + noise[i]
        U[i] = u
        integral += (demand[i] - Q[i]) / FS
        u = min(max(0.05 * (demand[i] - Q[i]) + 1.5 * integral, 0.0), 100.0)
    return U, Q


def recording(kind: str, valve: Valve, seed: int, n: int = N) -> Recording:
    """N samples at 100 Hz."""
    rng = np.random.default_rng(seed)
    U, dp = ramps_and_holds(rng, n, 0.0, 100.0), ramps_and_holds(rng, n, 3.0, 195.0)
    hours, rho = np.arange(n) / FS / 3600.0, RHO if kind == "coloured" else 0.0
    noise, at_end = coloured(rng, n, rho), valve
    match kind:
        case "drift":
            Q = valve(U, dp) * (1.0 + PER_HOUR * hours) + noise

            def at_end(U: Floats, dp: Floats) -> Floats:
                return np.asarray(valve(U, dp) * (1.0 + PER_HOUR * hours[-1]))
        case "wear":

            def edge(U: Floats, dp: Floats) -> Floats:
                return np.asarray(0.5 * np.clip(1.0 - U / 15.0, 0.0, 1.0) * np.sqrt(dp))

            Q = valve(U, dp) + edge(U, dp) * hours + noise

            def at_end(U: Floats, dp: Floats) -> Floats:
                return np.asarray(valve(U, dp) + edge(U, dp) * hours[-1])
        case "closed loop":
            dp = ramps_and_holds(rng, n, 20.0, 180.0)
            U, Q = closed_loop(rng, valve, dp)
        case "reacting":
            U = np.clip(U - GAIN * noise, 0.0, 100.0)
            Q = valve(U, dp) + noise
        case _:
            Q = valve(U, dp) + noise
    t = START + 10_000_000 * np.arange(n)
    samples = Samples.of(t, U, dp + 5.0, np.full(n, 5.0), Q, np.full(n, 40.0))
    return Recording(samples, at_end, rho)


def inside(samples: Samples, seed: int) -> tuple[Floats, Floats]:
    """Points (U, dp) within 5 % and 5 bar of three samples."""
    rng = np.random.default_rng([seed, 1])
    U, dp = rng.uniform(0.0, 100.0, POINTS), rng.uniform(1.0, 199.0, POINTS)
    near = [
        np.count_nonzero((np.abs(samples.U - u) < 5.0) & (np.abs(samples.dp - p) < 5.0)) >= 3
        for u, p in zip(U, dp, strict=True)
    ]
    return U[near], dp[near]


def oracle(of: Recording, state: AutoState, U: Floats, dp: Floats, at: int) -> float:
    """Width of the oracle's interval, l/min."""
    shape = Shape.from_array(state.shapes[0])
    structure = shape.spline(float(state.top[0])) if shape.cells else FiveTerms()
    samples = of.samples[:at]
    T = np.full(len(U), 40.0)
    X, Q = structure.regressors(samples.U, samples.dp, samples.T), samples.Q
    X, Q = X[1:] - of.rho * X[:-1], Q[1:] - of.rho * Q[:-1]
    asked, truth = structure.regressors(U, dp, T), of.valve(U, dp)
    errors = []
    for memory in MEMORIES:
        weight = np.exp((np.arange(len(Q)) - len(Q)) / memory)
        information = X.T @ (weight[:, None] * X) + RIDGE * np.eye(X.shape[1])
        theta = np.linalg.solve(information, X.T @ (weight * Q))
        errors.append(float(np.sqrt(np.mean((asked @ theta - truth) ** 2))))
    return 3.92 * min(errors)


def one(kind: str, valve: Valve, seed: int, n: int = N) -> Figures:
    """Figures of one seed."""
    of, auto = recording(kind, valve, seed, n), Auto()
    state, _ = auto.update(auto.initial_state(), of.samples)
    U, dp = inside(of.samples, seed)
    Q, std = auto.predict(state, U, dp, np.full_like(U, 40.0))
    error = Q - of.valve(U, dp)
    return Figures(
        covered=np.abs(error) <= 1.96 * std,
        width=float(np.mean(3.92 * std)),
        oracle=oracle(of, state, U, dp, n),
        rmse=float(np.sqrt(np.mean(error**2))) / SIGMA,
        changes=int(auto.change_counts(state)),
    )


def main(arguments: Sequence[str]) -> int:
    """Measure and print."""
    seeds = int(arguments[0]) if arguments else 10
    print(f"{'':14}{'':12}{'covered':>8}{'width':>8}{'RMSE, σ':>10} (worst)  changes")
    for kind in arguments[1:2] or KINDS:
        for name, valve in VALVES.items():
            all_of = [one(kind, valve, seed) for seed in range(seeds)]
            covered = np.concatenate([x.covered for x in all_of]).mean()
            width = np.mean([x.width for x in all_of]) / np.mean([x.oracle for x in all_of])
            rmse = np.array([x.rmse for x in all_of])
            changes = sum(x.changes for x in all_of)
            print(
                f"{kind:14}{name:12}{covered:8.3f}{width:8.2f}{rmse.mean():10.2f}"
                f" ({rmse.max():5.2f}){changes:9}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
