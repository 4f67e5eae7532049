"""The paper's Figure 1: source data by time (static … dynamic) and by form (structured … cycle).

One valve, whose spool of 2nd order and meter lag, is sampled 6,000 times in nine ways. *Static*
samples are taken at rest; *quasi-static* ones while U and Δp move slowly through their range, in
four minutes; *dynamic* ones while U steps several times a second, in one. *Structured* data have U
at discrete levels, *scattered* ones anywhere in the range, *operating points* lie about the four
points of a working cycle. A static map (a spline of 63 parameters by recursive least squares) is
learnt from each, and from dynamic data also the map together with spool and meter.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from paper.learning import learnt
from valvemap.model.dynamics import Dynamics, fit_dynamics
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Floats, Samples
from valvemap.model.tensor_spline import TensorSpline

SIGMA: Final = 0.4  # l/min; of the meter
N, STEP_S = 6_000, 5e-4  # samples; s, of the simulation
SPOOL_HZ, DAMPING, METER_S = 8.0, 0.7, 0.02
LEVELS: Final = np.arange(0.0, 101.0, 20.0)  # %; the paper's structured data have steps of U, too
CYCLE: Final = np.array([(22.0, 60.0), (45.0, 110.0), (70.0, 80.0), (35.0, 140.0)])  # %, bar
RATES_HZ: Final = {"static": 100, "quasi-static": 25, "dynamic": 100}
TIMES: Final = tuple(RATES_HZ)
FORMS: Final = ("structured", "scattered", "operating points")
_STATIC: Final = RecursiveLeastSquares(TensorSpline.uniform())
_SWEEP_S: Final = 30.0  # s; of a quasi-static sweep of U from end to end
_PERIODS_S: Final = {"quasi-static": 41.0, "dynamic": 7.3}  # s; of Δp


@dataclass(frozen=True)
class SourceTypes:
    """Errors over the range of U and Δp, in σ.

    ``static`` has those of the static map by time and form, ``dynamic`` those of the map with
    spool and meter by form; infinite: the samples tell none.
    """

    static: Mapping[str, Mapping[str, float]]
    dynamic: Mapping[str, float]

    @classmethod
    def measured(cls, seed: int) -> Self:
        """Learn from all nine recordings of a seed."""
        static: dict[str, dict[str, float]] = {}
        dynamic = {}
        for time in TIMES:
            static[time] = {}
            for form in FORMS:
                samples = recording(seed, time, form)
                state = learnt(_STATIC, samples)
                U, dp = places()
                Q, _ = _STATIC.predict(state, U, dp, np.full(len(U), 40.0))
                static[time][form] = _error(Q)
                if time == "dynamic":
                    found = fit_dynamics(samples)
                    dynamic[form] = (
                        _error(found.flow(U, dp)) if isinstance(found, Dynamics) else math.inf
                    )
        return cls(static, dynamic)


def flow(x: Floats, dp: Floats) -> Floats:
    """Return the valve's flow at the spool's position x (%) and dp (bar), l/min."""
    u = np.clip(0.01 * x, 0.0, 1.0)
    return np.asarray((5.0 * u + 9.0 * u**1.8) * np.sqrt(dp))


def places() -> tuple[Floats, Floats]:
    """Return the U (%) and dp (bar) at which maps are compared."""
    U, dp = np.meshgrid(np.linspace(5.0, 95.0, 31), np.linspace(30.0, 150.0, 9))
    return U.ravel(), dp.ravel()


def recording(seed: int, time: str, form: str) -> Samples:
    """Return a recording of one kind."""
    rng = np.random.default_rng([seed, TIMES.index(time), FORMS.index(form)])
    n, rate = N, RATES_HZ[time]
    t = np.arange(n) / rate
    points = CYCLE[rng.integers(len(CYCLE), size=n)]
    if time == "static":
        dp = rng.uniform(20.0, 160.0, n)
        U = rng.choice(LEVELS, n) if form == "structured" else rng.uniform(0.0, 100.0, n)
    else:
        dp = 90.0 + 70.0 * np.sin(2.0 * np.pi * t / _PERIODS_S[time])
        held = _held(rng, n, rate * (10.0 if time == "quasi-static" else 0.3))
        points = points[held]
        if form == "structured":
            U = rng.choice(LEVELS, n)[held]
        elif time == "quasi-static":
            U = 100.0 * np.abs((t / _SWEEP_S + 1.0) % 2.0 - 1.0)
        else:
            U = rng.uniform(0.0, 100.0, n)[held]
    if form == "operating points":
        U = points[:, 0] + 2.0 * np.sin(2.0 * np.pi * t / 3.1)
        dp = points[:, 1] + 3.0 * np.sin(2.0 * np.pi * t / 7.3)
    Q = flow(U, dp) if time == "static" else _lagged(U, dp, rate)
    if time == "quasi-static" and form != "scattered":
        Q = flow(U, dp)  # the few moments after a step are left out
    noisy = Q + SIGMA * rng.standard_normal(n)
    stamps = np.arange(n, dtype=np.int64) * (10**9 // rate)
    return Samples.of(stamps, U, dp, np.zeros(n), noisy, np.full(n, 40.0))


def _held(rng: np.random.Generator, n: int, mean: float) -> NDArray[np.int64]:
    """Return for each sample the number of the one at which its level began, (n,)."""
    begins = rng.random(n) < 1.0 / mean
    begins[0] = True
    return np.maximum.accumulate(np.where(begins, np.arange(n), 0))


def _lagged(U: Floats, dp: Floats, rate: int) -> Floats:
    """Return the metered flow behind the spool and the meter, sampled before U changes."""
    w, h, parts = 2.0 * math.pi * SPOOL_HZ, STEP_S, round(1.0 / (rate * STEP_S))
    share = -math.expm1(-h / METER_S)
    x, v, y = float(U[0]), 0.0, float(flow(U[:1], dp[:1])[0])
    out = np.empty(len(U))
    for k, (u, drop) in enumerate(zip(U.tolist(), dp.tolist(), strict=True)):
        out[k] = y
        root = math.sqrt(drop)
        for _ in range(parts):
            v += h * (w * w * (u - x) - 2.0 * DAMPING * w * v)
            x += h * v
            s = min(max(0.01 * x, 0.0), 1.0)
            y += share * ((5.0 * s + 9.0 * s**1.8) * root - y)
    return out


def _error(Q: Floats) -> float:
    U, dp = places()
    return float(np.sqrt(np.mean((Q - flow(U, dp)) ** 2))) / SIGMA
