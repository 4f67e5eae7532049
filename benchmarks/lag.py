"""How well `Auto` finds lags: cells of `benchmarks.honest_maps`.

Lags found, the map's RMSE inside the data, in σ, beside that of the same cycle without lags, and
the loop claimed (there is none), on a machine's cycle of 200 s.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache, partial
from typing import Final

import numpy as np

from benchmarks import circumstances as c
from benchmarks.cells import Cell, Figures, Judged
from benchmarks.coverage import AUTO

N: Final = 20_000  # samples
PAIRS: Final = (  # of U's effect, of the meter, s
    *((0.0, tau) for tau in (0.0, 0.05, 0.2, 0.3)),
    *((tau, 0.0) for tau in (0.05, 0.1)),
    *((0.05, 0.05), (0.1, 0.2), (0.03, 0.3)),
)
WITHIN: Final = 0.2, 0.010  # share, s: so near to the true one a lag must be
TIMES, AT_MOST = 2.0, 0.6  # times the lag-free error, σ: the map's error, the larger of them


def one(name: str, tau_U: float, tau_Q: float, seed: int) -> Figures:
    """Lags found, s; errors in σ; share of true flows held; width of the loop, %."""
    U, Q = np.array(_learnt(name, tau_U, tau_Q, seed)).tolist(), _learnt(name, 0.0, 0.0, seed)
    return {
        "lag_U": U[0],
        "lag_Q": U[1],
        "error": U[2],
        "held": U[3],
        "loop": U[4],
        "lag_free": Q[2],
    }


def judge(tau_U: float, tau_Q: float, found: Sequence[Figures]) -> Judged:
    """Every seed: each lag, error and loop."""
    share, least = WITHIN
    lags = np.array([(f["lag_U"], f["lag_Q"]) for f in found])
    true = np.array([tau_U, tau_Q])
    near = (np.abs(lags - true) <= np.maximum(share * true, least)).all()
    error, free = (np.array([f[k] for f in found]) for k in ("error", "lag_free"))
    good = (error <= np.maximum(TIMES * free, AT_MOST)).sum()
    loop = max(f["loop"] for f in found)
    U, Q = 1e3 * lags.mean(axis=0)
    figure = (
        f"lags {U:.0f}, {Q:.0f} ms, {error.mean():.2f} (worst {error.max():.2f}) σ beside "
        f"{free.mean():.2f}, held {np.mean([f['held'] for f in found]):.2f}, loop {loop:.1f} %"
    )
    met = bool(near) and good == len(found) and loop == 0.0
    return Judged(figure, "≤ 2 × lag-free or .6 σ, 20 % or 10 ms, no loop", met)


def cells() -> Mapping[str, Cell]:
    """A cell per pair of lags and valve."""
    return {
        f"lag of U {1e3 * tau_U:.0f}, of Q {1e3 * tau_Q:.0f} ms, Auto on {name}": Cell(
            10, partial(one, name, tau_U, tau_Q), partial(judge, tau_U, tau_Q)
        )
        for name in ("ordinary", "saturating")
        for tau_U, tau_Q in PAIRS
    }


@lru_cache(maxsize=64)
def _learnt(
    name: str, tau_U: float, tau_Q: float, seed: int
) -> tuple[float, float, float, float, float]:
    valve = c.VALVES[name]
    U, dp = c.cycle(seed, N)
    Q = c.lagged(valve(c.lagged(U, tau_U), dp), tau_Q) + c.white(seed, N)
    state, _ = AUTO.update(AUTO.initial_state(), c.samples_of(U, dp, Q))
    at = c.inside(U, dp)
    said, std = AUTO.predict(state, at.U, at.dp, at.T)
    error = said - valve(at.U, at.dp)
    held = float(np.mean(np.abs(error) <= c.TWO_SIDED_95 * std))
    loop = 2.0 * AUTO.half_play(state)
    return *AUTO.lags(state), c.rms(error) / c.SIGMA, held, loop
