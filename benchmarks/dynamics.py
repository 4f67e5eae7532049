"""Dynamics of spool and meter on simulated valves: ``python -m benchmarks.dynamics [--seeds N]``.

Random steps of U for 60 s at a slowly swept Δp; spool of second order with slew limit, play-free,
integrated at 100 kHz; σ = .4 l/min. Rows: f ≤ 25 Hz at 100 Hz, 8 … 60 Hz at 1 kHz; slew reached or
not. ``--report`` takes the seeds that nothing is tuned on.
"""

import argparse
import math
import sys
import time
from collections.abc import Sequence
from typing import Any, Final

import numba
import numpy as np
from scipy.linalg import expm

from benchmarks import circumstances as c
from benchmarks.one_model_rows import behind
from valvemap.model.dynamics import Dynamics, fit_dynamics
from valvemap.model.samples import Floats, Samples
from valvemap.pipeline.dynamics_reference import DynamicsReferences
from valvemap.vocabulary.dynamics import DynamicsStatus
from valvemap.vocabulary.statuses import Status

REPORT: Final = 100_000
FINE_HZ: Final = 100_000
SECONDS: Final = 60.0
NEVER: Final = 1e9


def spool_of(U: Floats, f: float, zeta: float, slew: float, h: float) -> Floats:
    """Return the spool's position at the ends of N steps of h s, within which U stands.

    Second order, exact; a limited speed is cut off at the end of a step.
    """
    w, x = 2.0 * np.pi * f, np.empty(len(U))
    _moved(U, expm(h * np.array([[0.0, 1.0], [-w * w, -2.0 * zeta * w]])), slew, h, x)
    return x


@numba.njit
def _moved(U, E, slew, h, out):
    x, v = U[0], 0.0
    for k in range(len(U)):
        e = x - U[k]
        x, new = U[k] + E[0, 0] * e + E[0, 1] * v, E[1, 0] * e + E[1, 1] * v
        if abs(new) > slew:
            new = math.copysign(slew, new)
            x = U[k] + e + 0.5 * h * (v + new)
        v = new
        out[k] = x


@numba.njit
def metered(Q, lag, many):
    """A meter of first order; ``Q`` is the flow at the ends of steps, U changes at the samples."""
    share, y, before = 1.0 - np.exp(-1.0 / (FINE_HZ * lag)), Q[0], Q[0]
    out = np.empty(len(Q) // many)
    for k in range(len(Q)):
        if k % many == 0:
            out[k // many] = y
        y += share * (0.5 * (before + Q[k]) - y)
        before = Q[k]
    return out


def plant(
    seed: int,
    rate: float,
    *,
    limited: bool,
    again: int = 0,
    slower: float = 1.0,
    play: float = 0.0,
) -> tuple[Samples, dict[str, float], Any]:
    """Samples, the truth, and the static map.

    ``again`` gives other steps of the same plant, ``slower`` a share of its natural frequency.
    ``play`` is between U and the spool, %.
    """
    rng = np.random.default_rng([seed, 23])
    f = float(rng.uniform(5.0, 25.0) if rate < 500 else rng.uniform(8.0, 60.0))
    zeta, lag = float(rng.uniform(0.5, 1.0)), float(rng.uniform(0.005, 0.05))
    dead, slew = float(rng.uniform(0.0, 0.01)), NEVER
    if limited:  # below the fastest that a full step reaches
        slew = float(rng.uniform(0.15, 0.6)) * 100.0 * f * 2.4
    N, many = round(SECONDS * rate), round(FINE_HZ / rate)
    f *= slower
    if again:
        rng = np.random.default_rng([seed, 29, again])
    U = np.empty(N)
    k = 0
    while k < N:
        n = round(rng.uniform(0.15, 0.8) * rate)
        U[k : k + n] = rng.uniform(0.0, 100.0)
        k += n
    fine = np.repeat(behind(U, play), many)
    late = round(dead * FINE_HZ)
    dead = late / FINE_HZ
    fine = np.concatenate([np.full(late, U[0]), fine[: len(fine) - late]])
    t = np.arange(len(fine)) / FINE_HZ
    dp = 90.0 + 70.0 * np.sin(2 * np.pi * t / 7.3)
    names = ("ordinary", "dead band", "saturating", "progressive", "laminar")
    valve = c.VALVES[names[seed % len(names)]]
    x = spool_of(fine, f, zeta, slew, 1.0 / FINE_HZ)
    Q = valve(np.clip(x, 0.0, None), dp)
    Q = metered(Q, lag, many) + c.white(seed + 100_000 * again, N)
    samples = Samples.of(
        np.rint(np.arange(N) * 1e9 / rate).astype(np.int64), U, dp[::many], np.zeros(N), Q
    )
    truth = {"f": f, "zeta": zeta, "slew": slew, "dead": dead, "lag": lag}
    step = float(np.abs(np.diff(U)).max())
    from_zero = spool_of(
        np.concatenate([[0.0], np.full(2 * FINE_HZ, step)]), f, zeta, slew, 1.0 / FINE_HZ
    )
    k = int(np.flatnonzero(from_zero >= 0.9 * step)[0])
    part = (0.9 * step - from_zero[k - 1]) / (from_zero[k] - from_zero[k - 1])
    truth["T90"] = (k - 1 + part) / FINE_HZ + dead
    return samples, truth, valve


def row(seed: int, rate: float, *, limited: bool, play: float = 0.0) -> dict[str, float]:
    """Errors of one plant."""
    samples, truth, valve = plant(seed, rate, limited=limited, play=play)
    began = time.process_time()
    found = fit_dynamics(samples)
    spent = time.process_time() - began
    assert isinstance(found, Dynamics), found  # noqa: S101
    U, dp = (x.ravel() for x in np.meshgrid(np.linspace(3, 97, 30), np.linspace(25, 155, 9)))
    error = c.rms(found.flow(U, dp) - valve(U, dp)) / c.SIGMA
    quantities = {
        "f": found.natural_frequency,
        "zeta": found.damping,
        "slew": found.slew,
        "dead": found.dead_time,
        "lag": found.meter_lag,
        "T90": found.T90,
    }
    out = {"map": error, "cpu": spent, "noise": found.noise / c.SIGMA}
    out["play"] = found.play_percent - play
    for name, one in quantities.items():
        out[name] = one.value - truth[name]
        out[f"{name} rel"] = one.value / truth[name] - 1.0
        out[f"{name} off/std"] = (one.value - truth[name]) / one.std
        out[f"{name} held"] = float(abs(one.value - truth[name]) <= 1.96 * one.std)
        out[f"{name} unexcited"] = float(one.status is Status.UNEXCITED)
    return out


def changes(seeds: range, rate: float = 100.0) -> str:
    """Return how often a change is found: none, and the natural frequency halved."""
    found = {1.0: 0, 0.5: 0}
    judged = dict.fromkeys(found, 0)
    for seed in seeds:
        for slower in found:
            references = DynamicsReferences()
            for again, share in ((1, 1.0), (2, slower)):
                samples, _, _ = plant(seed, rate, limited=False, again=again, slower=share)
                results = references.judge(0, fit_dynamics(samples), 0)
            judged[slower] += results.status is DynamicsStatus.OK
            found[slower] += bool(results.findings)
    return (
        f"changes between two minutes at {rate:g} Hz: {found[1.0]} found of {judged[1.0]} without "
        f"one, {found[0.5]} of {judged[0.5]} with half the natural frequency"
    )


def healthy(hours: int, first: int) -> str:
    """Return how many minutes of healthy valves have a finding: another valve each hour."""
    found = judged = 0
    for seed in range(first, first + hours):
        references = DynamicsReferences()
        for minute in range(1, 61):
            samples, _, _ = plant(seed, 100.0, limited=bool(seed % 2), again=minute)
            results = references.judge(0, fit_dynamics(samples), 0)
            judged += results.status is DynamicsStatus.OK
            found += bool(results.findings)
            if minute % 10 == 0:
                print(f"hour {seed - first + 1}, minute {minute}: {found} in {judged}", flush=True)
    return f"{hours} healthy hours at 100 Hz: {found} findings in {judged} good fits"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--report", action="store_true", help="seeds that nothing is tuned on")
    parser.add_argument("--first", type=int, help="first seed, in place of these")
    parser.add_argument("--rate", type=float, help="of the samples, Hz, in place of 100 and 1,000")
    parser.add_argument("--slew", choices=("reached", "not"), help="one of both alone")
    parser.add_argument("--play", type=float, default=0.0, help="of the spool, %%")
    parser.add_argument("--each", action="store_true", help="print every seed")
    parser.add_argument("--changes", action="store_true", help="how often a change is found")
    parser.add_argument("--hours", type=int, default=0, help="hours of healthy valves")
    wanted = parser.parse_args(arguments)
    first = (REPORT if wanted.report else 0) if wanted.first is None else wanted.first
    if wanted.hours:
        print(healthy(wanted.hours, first))
        return 0
    if wanted.changes:
        print(changes(range(first, first + wanted.seeds)))
        return 0
    for rate in (100.0, 1000.0) if wanted.rate is None else (wanted.rate,):
        for limited in (True, False):
            if wanted.slew is not None and limited != (wanted.slew == "reached"):
                continue
            rows = []
            for seed in range(first, first + wanted.seeds):
                rows.append(row(seed, rate, limited=limited, play=wanted.play))
                if wanted.each:
                    print({k: round(v, 4) for k, v in rows[-1].items()}, flush=True)
            at = {k: np.array([r[k] for r in rows]) for k in rows[0]}
            lines = [f"map {np.max(at['map']):.2f} σ at most, median {np.median(at['map']):.2f}"]
            for name in ("f", "slew"):
                if name == "slew" and not limited:
                    lines.append(f"slew UNEXCITED in {at['slew unexcited'].mean():.2f}")
                    continue
                share = np.mean(np.abs(at[f"{name} rel"]) <= 0.03)
                lines.append(
                    f"{name} within 3 % {share:.2f} (RMS {100 * c.rms(at[f'{name} rel']):.1f} %, "
                    f"bias {100 * at[f'{name} rel'].mean():+.1f} %)"
                )
            near = np.mean(np.abs(at["zeta"]) <= 0.05)
            lines.append(f"ζ within .05 {near:.2f} (RMS {c.rms(at['zeta']):.3f})")
            good = (np.abs(at["T90"]) <= 1e-3) | (np.abs(at["T90 rel"]) <= 0.03)
            lines.append(f"T90 {good.mean():.2f} (RMS {1e3 * c.rms(at['T90']):.2f} ms)")
            lines.append(f"play RMS {c.rms(at['play']):.2f} %")
            lines.append(f"lag RMS {1e3 * c.rms(at['lag']):.2f} ms")
            names = ["f", "zeta", "dead", "lag", "T90", *(["slew"] if limited else [])]
            held = {name: at[f"{name} held"].mean() for name in names}
            lines.append("held " + ", ".join(f"{k} {v:.2f}" for k, v in held.items()))
            lines.append(f"{np.mean(at['cpu']):.0f} s of processor time")
            what = "slew reached" if limited else "no slew limit"
            print(f"{rate:g} Hz, {what}: " + "; ".join(lines), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
