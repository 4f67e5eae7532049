"""Plants whose sensors are off: how often the interval holds the true flow, and how wide it is.

Cells of `benchmarks.honest_maps`: offsets of p1, p2 and Q drawn from the declared class, uniform
within its limits; asked at true U and Δp. *Ideal* is the narrowest constant multiple of the total
standard deviation that covers .95.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from benchmarks import circumstances as c
from benchmarks.cells import Cell, Figures, Judged
from benchmarks.coverage import AUTO
from benchmarks.coverage import RLS as ADAPTIVE
from valvemap.model.estimator import Estimator
from valvemap.model.samples import Samples
from valvemap.model.sensor_accuracy import SensorAccuracy, systematic_std

CLASS: Final = SensorAccuracy(p1=1.0, p2=1.0, Q=0.8)
N: Final = 4_000  # scattered samples
HELD, WIDEST = 0.93, 1.3  # share, times the ideal


def asked() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points U, dp and T."""
    U, dp = np.meshgrid(np.linspace(10, 95, 12), np.linspace(15, 190, 10))
    return U.ravel(), dp.ravel(), np.full(U.size, 40.0)


def taught(estimator: Estimator[Any], valve: c.Valve, seed: int) -> Any:
    """State after samples through sensors that are off, each by a constant within its limits."""
    rng = np.random.default_rng(seed)
    U, dp = rng.uniform(0, 100, N), rng.uniform(5, 195, N)
    off = {name: rng.uniform(-1, 1) * getattr(CLASS, name) for name in ("p1", "p2", "Q")}
    p2 = rng.uniform(5, 50, N)
    samples = Samples.of(
        t=np.arange(N) * 10_000_000,
        U=U,
        p1=p2 + dp + off["p1"],
        p2=p2 + off["p2"],
        Q=valve(U, dp) + off["Q"] + rng.normal(0, c.SIGMA, N),
        T=np.full(N, 40.0),
    )
    return estimator.update(estimator.initial_state(), samples)[0]


def one(estimator: Estimator[Any], valve: c.Valve, seed: int) -> Figures:
    """Errors of the map over its total standard deviation, at the points asked."""
    state, (U, dp, T) = taught(estimator, valve, seed), asked()
    Q, std = estimator.predict(state, U, dp, T)

    def flow(*points: np.ndarray) -> np.ndarray:
        return estimator.predict(state, *points)[0]

    total = np.hypot(std, systematic_std(CLASS, flow, (U, dp, T)))
    return {"ratios": np.round((Q - valve(U, dp)) / total, 4).tolist()}


def judge(found: Sequence[Figures]) -> Judged:
    """Share held, pooled; width over the ideal."""
    ratios = np.abs([f["ratios"] for f in found])
    share, width = np.mean(ratios <= c.TWO_SIDED_95), c.TWO_SIDED_95 / np.quantile(ratios, 0.95)
    of_plants = np.mean(ratios <= c.TWO_SIDED_95, axis=1)
    error = float(np.std(of_plants) / np.sqrt(max(len(found) - 1, 1)))
    figure = f"{share:.3f} ± {error:.3f}, width {width:.2f} × ideal"
    return Judged(figure, f"≥ {HELD}, ≤ {WIDEST} ×", bool(share >= HELD and width <= WIDEST))


def cells() -> Mapping[str, Cell]:
    """A cell per estimator and valve, of 200 plants."""
    return {
        f"plants, {name} on {valve}": Cell(200, partial(one, estimator, c.VALVES[valve]), judge)
        for name, estimator, valve in (
            ("RLS", ADAPTIVE, "eq. (7)"),
            ("Auto", AUTO, "eq. (7)"),
            ("Auto", AUTO, "ordinary"),
            ("Auto", AUTO, "saturating"),
        )
    }
