"""Sticky spools under steps and PRBS: ``python -m benchmarks.friction [--seeds N] [--hours N]``.

A spool of second order (5 … 25 Hz) with Coulomb friction of 2 % of U, or without any, integrated at
10 kHz; σ = .4 l/min, 100 Hz, a meter's lag. *Steps* go anywhere in the range, *PRBS* ± 5 % about
levels that change every 4 s. `Auto` is asked for play or hysteresis every 10 s, for 120 s.
``--hours`` has healthy valves alone, another one each hour. ``--report`` takes the seeds that
nothing is tuned on.
"""

import argparse
import sys
from collections.abc import Sequence
from typing import Any, Final

import numba
import numpy as np
from scipy import signal

from benchmarks import circumstances as c
from valvemap.config.estimators import AutoConfig, build_estimator
from valvemap.model.samples import Samples
from valvemap.vocabulary.findings import FindingCode

REPORT: Final = 110_000
FINE_HZ, RATE_HZ, ASKED_S = 10_000, 100, 10
FRICTION: Final = 2.0  # % of U
FOUND: Final = {FindingCode.PLAY, FindingCode.HYSTERESIS}


@numba.njit
def sticky(U, f, zeta, friction, h):
    """Second order with Coulomb friction, in % of U; semi-implicit Euler."""
    w, x, v = 2 * np.pi * f, U[0], 0.0
    out = np.empty(len(U))
    for k in range(len(U)):
        pull = w * w * (U[k] - x) - 2 * zeta * w * v
        most = w * w * friction
        if v == 0.0 and abs(pull) <= most:
            out[k] = x
            continue
        side = np.sign(v) if v != 0.0 else np.sign(pull)
        new = v + h * (pull - most * side)
        v = 0.0 if new * side < 0.0 else new  # it comes to rest, and may break loose again
        x += h * v
        out[k] = x
    return out


def moved(rng: Any, seconds: float, *, prbs: bool) -> Any:
    """U by sample."""
    N = round(seconds * RATE_HZ)
    U, k = np.empty(N), 0
    while k < N:
        n = round(rng.uniform(0.1, 0.4 if prbs else 0.8) * RATE_HZ)
        U[k : k + n] = rng.choice([-5.0, 5.0]) if prbs else rng.uniform(0.0, 100.0)
        k += n
    if prbs:
        U += np.repeat(rng.uniform(10.0, 90.0, N // (4 * RATE_HZ) + 1), 4 * RATE_HZ)[:N]
    return U


def plant(seed: int, seconds: float, friction: float, *, prbs: bool) -> Samples:
    """Samples of one valve."""
    rng = np.random.default_rng([seed, 31])
    f, zeta, lag = rng.uniform(5.0, 25.0), rng.uniform(0.5, 1.0), rng.uniform(0.005, 0.05)
    U, many = moved(rng, seconds, prbs=prbs), FINE_HZ // RATE_HZ
    x = sticky(np.repeat(U, many), f, zeta, friction, 1.0 / FINE_HZ)
    t = np.arange(len(x)) / FINE_HZ
    dp = 90.0 + 70.0 * np.sin(2 * np.pi * t / 7.3)
    valve = c.VALVES[("ordinary", "dead band", "saturating", "progressive", "laminar")[seed % 5]]
    share = 1.0 - np.exp(-1.0 / (FINE_HZ * lag))
    flow = signal.lfilter([share], [1.0, share - 1.0], valve(np.clip(x, 0.0, None), dp))
    Q = flow[::many] + c.white(seed, len(U))
    ns = np.arange(len(U)) * (10**9 // RATE_HZ)
    return Samples.of(ns, U, dp[::many], np.zeros(len(U)), Q, np.full(len(U), 40.0))


def found_at(samples: Samples) -> tuple[float, str]:
    """Time at which `Auto` first tells friction or play, s, and its words; infinite if never."""
    estimator = build_estimator(AutoConfig(), (0.0, 100.0), (0.0, 200.0), (0.0, 200.0))
    state, many = estimator.initial_state(), ASKED_S * RATE_HZ
    for first in range(0, len(samples), many):
        state, _ = estimator.update(state, samples[first : first + many])
        told = [one for one in estimator.findings(state) if one.code in FOUND]
        if told:
            return (first + many) / RATE_HZ, told[0].sentence
    return np.inf, ""


def table(seeds: Sequence[int]) -> None:
    """Print how many sticky and healthy valves are found, and when."""
    for prbs in (False, True):
        for friction in (FRICTION, 0.0):
            found = [found_at(plant(seed, 120.0, friction, prbs=prbs)) for seed in seeds]
            times = sorted(t for t, _ in found if np.isfinite(t))
            when = f", after {np.median(times):.0f} s (at most {times[-1]:.0f} s)" if times else ""
            words = next((said for _, said in found if said), "")
            print(
                f"{'PRBS' if prbs else 'steps'}, friction {friction:g} %: {len(times)} of "
                f"{len(found)} found{when} {words}",
                flush=True,
            )


def healthy(hours: int, first: int) -> None:
    """Print in how many healthy hours there is a finding."""
    for prbs in (False, True):
        found = 0
        for seed in range(first, first + hours):
            samples = plant(seed, 3600.0, 0.0, prbs=prbs)
            at, said = found_at(samples)
            found += np.isfinite(at)
            print(f"hour {seed - first + 1}: {at:g} s {said}", flush=True)
        print(f"{'PRBS' if prbs else 'steps'}: {found} of {hours} healthy hours have a finding")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--hours", type=int, default=0, help="hours of healthy valves")
    parser.add_argument("--report", action="store_true", help="seeds that nothing is tuned on")
    parser.add_argument("--first", type=int, help="first seed, in place of these")
    wanted = parser.parse_args(arguments)
    first = (REPORT if wanted.report else 0) if wanted.first is None else wanted.first
    if wanted.hours:
        healthy(wanted.hours, first)
    else:
        table(range(first, first + wanted.seeds))
    return 0


if __name__ == "__main__":
    sys.exit(main())
