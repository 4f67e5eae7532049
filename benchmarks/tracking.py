"""Maps that must stay right where eq. (7) misfits, and follow a valve that drifts or wears.

Cells of `benchmarks.honest_maps`: error of the map over the visited region, in σ, beside the
bar: of RLS 1.3 times the best eq. (7) of the moment there (and 0.5 under drift), of `Auto` 2.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np

from benchmarks import circumstances as c
from benchmarks.cells import Cell, Figures, Judged
from benchmarks.coverage import AUTO, RLS
from valvemap.model.estimator import Estimator

DRIFTING, WEARING = 180_000, 360_000  # samples: half an hour, an hour
OF_AUTO: Final = 2.0  # σ


def structured(valve: c.Valve, seed: int) -> Figures:
    """U in steps."""
    U, dp = c.structured()
    return _error(RLS, U, dp, valve(U, dp) + c.white(seed, len(U)), valve, 0.0)


def drift(estimator: Estimator[Any], valve: c.Valve, seed: int) -> Figures:
    """A gain that drifts by -15 %/h, on a cycle."""
    U, dp = c.cycle(seed, DRIFTING)
    factor = c.drift(DRIFTING)
    Q = valve(U, dp) * factor + c.white(seed, DRIFTING)
    return _error(estimator, U, dp, Q, lambda U, dp: factor[-1] * valve(U, dp), 0.5)


def edge(estimator: Estimator[Any], valve: c.Valve, seed: int) -> Figures:
    """An edge that wears within an hour, on a cycle."""
    U, dp = c.cycle(seed, WEARING)
    Q = valve(U, dp) + c.wear(WEARING) * c.worn_edge(U, dp) + c.white(seed, WEARING)
    return _error(estimator, U, dp, Q, lambda U, dp: valve(U, dp) + c.worn_edge(U, dp), 0.5)


def judge(found: Sequence[Figures]) -> Judged:
    """Worst and mean error; every seed within its bar."""
    error, most = (np.array([f[k] for f in found]) for k in ("error", "demanded"))
    says = ", ".join(sorted({f["says"] for f in found}))
    figure = f"{error.mean():.2f} (worst {error.max():.2f}) σ, {says}"
    return Judged(figure, f"≤ {most.mean():.2f} σ", bool((error <= most).all()))


def cells() -> Mapping[str, Cell]:
    """A cell per circumstance, estimator and valve."""
    found = {
        f"structured, RLS on {name}": Cell(10, partial(structured, c.VALVES[name]), judge)
        for name in ("dead band", "S-shape", "two slopes", "ordinary")
    }
    for title, measure in (("drift -15 %/h", drift), ("edge that wears", edge)):
        for estimator, names in (
            (RLS, ("eq. (7)", "ordinary", "S-shape")),
            (AUTO, ("ordinary", "saturating", "S-shape")),
        ):
            for name in names:
                one = partial(measure, estimator, c.VALVES[name])
                found[f"{title}, {_name(estimator)} on {name}"] = Cell(10, one, judge)
    return found


def _name(estimator: Estimator[Any]) -> str:
    return "RLS" if estimator is RLS else "Auto"


def _error(
    estimator: Estimator[Any],
    U: np.ndarray,
    dp: np.ndarray,
    Q: np.ndarray,
    truth: c.Valve,
    slack: float,
) -> Figures:
    state, _ = estimator.update(estimator.initial_state(), c.samples_of(U, dp, Q))
    region = c.inside(U, dp)
    said, _ = estimator.predict(state, region.U, region.dp, region.T)
    error = c.rms(said - truth(region.U, region.dp)) / c.SIGMA
    _, best = c.best_eq7(region, truth)
    demanded = 1.3 * best / c.SIGMA + slack if estimator is RLS else OF_AUTO
    return {"error": error, "demanded": demanded, "says": estimator.adaptation(state).name}
