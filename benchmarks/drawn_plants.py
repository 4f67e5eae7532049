"""Plants drawn at random: a valve, a working cycle, a sample rate, up to three circumstances.

None of them is a row of `benchmarks.one_model`; `benchmarks.unseen_plants` measures on them.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from benchmarks import circumstances as c
from benchmarks.one_model_rows import Flow, Row
from valvemap.model.samples import Samples
from valvemap.vocabulary.findings import FindingCode

SECONDS: Final = 300.0, 900.0  # of the shortest and the longest run
RATES: Final = 5.0, 10.0, 20.0, 50.0, 100.0, 200.0  # Hz
MOST_SAMPLES: Final = 60_000  # of a run
MOMENTS: Final = 0.3, 0.6, 1.0  # of a run, after which the map is asked

Rng = np.random.Generator
Path = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # s -> U, %; share of the largest Δp

# Valves: opening u in -1 … 1, r = Δp over its largest; the flow over the largest one.


def notched(rng: Rng) -> Flow:
    """A spool with notches: straight pieces between three to five knees."""
    knees = np.sort(rng.uniform(0.1, 0.9, rng.integers(3, 6)))
    at, lap = np.concatenate([[0.0], knees, [1.0]]), rng.uniform(0.02, 0.12)
    rise = np.cumsum(rng.uniform(0.2, 2.0, len(at)) * np.diff(at, prepend=0.0))
    rise = (rise - rise[0]) / (rise[-1] - rise[0])
    return lambda u, r: np.interp((u - lap) / (1.0 - lap), at, rise) * np.sqrt(r)


def asymmetric(rng: Rng) -> Flow:
    """An S whose ends bend differently, and a flow force that closes the spool at high Δp."""
    low, high, force = rng.uniform(1.3, 2.6), rng.uniform(1.2, 3.0), rng.uniform(0.0, 0.2)

    def flow(u, r):
        return (1.0 - (1.0 - np.clip(u, 0, 1) ** low) ** high) * np.sqrt(r) * (1.0 - force * r)

    return flow


def servo(rng: Rng) -> Flow:
    """Zero lap, both ways: clearance rounds the edge, leakage flows where it is closed."""
    gap, other = rng.uniform(0.003, 0.02), rng.uniform(0.7, 1.0)

    def flow(u, r):
        opening = 0.5 * (np.hypot(u, gap) + u), other * 0.5 * (np.hypot(u, gap) - u)
        return (opening[0] - opening[1]) * np.sqrt(r)

    return flow


def poppet(rng: Rng) -> Flow:
    """A poppet: Δp helps to open it, below a least Δp it stays shut."""
    lap, helped, crack = rng.uniform(0.08, 0.2), rng.uniform(0.0, 0.08), rng.uniform(0.01, 0.05)
    bend = rng.uniform(1.0, 1.6)

    def flow(u, r):
        opening = np.clip((u - lap + helped * r) / (1.0 - lap + helped), 0.0, 1.0)
        return opening**bend * np.sqrt(np.clip(r - crack, 0.0, None))

    return flow


def leaking(rng: Rng) -> Flow:
    """Leakage at U = 0 that is laminar, a soft saturation, flow forces that limit the flow."""
    leak, soft, most = rng.uniform(0.0, 0.04), rng.uniform(0.4, 1.2), rng.uniform(0.6, 1.5)
    lap = rng.uniform(0.0, 0.06)

    def flow(u, r):
        opening = np.tanh(np.clip((u - lap) / (1.0 - lap), 0.0, 1.0) / soft) / np.tanh(1.0 / soft)
        return opening * most * np.tanh(np.sqrt(r) / most) + leak * r

    return flow


VALVES: Final = notched, asymmetric, servo, poppet, leaking


# Working cycles: waypoints of (duration in s, U in %, share of Δp), joined by straight lines.


def moulding(rng: Rng) -> list[tuple[float, float, float]]:
    """A shot: mould closes, three speeds of injection, holding pressure, cooling, mould opens."""
    speeds = np.clip([85, 60, 35] * rng.normal(1, 0.04, 3), 0, 100)
    load = rng.uniform(0.85, 1.0)
    shot = [(0.3, 45, 0.7), (1.5, 45, 0.65), (0.2, 0, 0.9), (0.5, 0, 0.95)]
    for k, speed in enumerate(speeds):
        shot += [(0.1, speed, 0.8 * load - 0.2 * k), (rng.uniform(0.5, 1.2), speed, 0.62 - 0.2 * k)]
    shot += [(0.1, 9 * rng.normal(1, 0.1), 0.15), (3.0, 8, 0.08), (0.1, 0, 0.9), (4.0, 0, 0.9)]
    return [*shot, (0.4, 30, 0.75), (1.0, 25 * load, 0.7), (0.3, 0, 0.9)]


def pressing(rng: Rng) -> list[tuple[float, float, float]]:
    """A stroke: fast approach, counter pressure in steps, dwell, decompression, return."""
    fast, slow, dwell = rng.normal(90, 3), rng.normal(30, 4), rng.uniform(2, 8)
    stroke = [(0.5, fast, 0.5), (1.2, fast, 0.45), (0.3, slow, 0.6)]
    stroke += [(0.4, slow, share) for share in (0.6, 0.42, 0.41, 0.25, 0.24, 0.1)]
    stroke += [(0.2, 4, 0.06), (dwell, 4, 0.05), (1.5, 12, 0.3)]
    return [*stroke, (0.4, 70, 0.65), (1.5, 70, 0.7)]


def winching(rng: Rng) -> list[tuple[float, float, float]]:
    """A joystick: a level, held with a hand's tremor, against a load that swings."""
    level, load = rng.choice([0.0, rng.uniform(5, 100)], p=[0.2, 0.8]), rng.uniform(0.1, 1.0)
    tremor = rng.normal(0, (1.5, 0.03), (rng.integers(2, 25), 2))
    return [(rng.uniform(0.2, 1.5), level, load), *((0.12, level + u, load + r) for u, r in tremor)]


def hammering(rng: Rng) -> list[tuple[float, float, float]]:
    """A blow: open within a tenth of a second and shut again."""
    top, long = np.clip(rng.normal(75, 15), 10, 100), rng.uniform(0.1, 0.5)
    pause = rng.uniform(0.2, 1.0)
    return [(0.1, top, 0.5), (long, top, 0.35), (0.1, 0, 0.8), (pause, 0, rng.uniform(0.85, 1.0))]


CYCLES: Final = moulding, pressing, winching, hammering


def worked(cycle: Callable[[Rng], list], last: float, rng: Rng, both: bool) -> Path:  # noqa: FBT001
    """U and share of Δp at any times up to ``last``; where ``both``, every other turn has U < 0."""
    points, sign = [(0.0, 0.0, 0.8)], 1.0
    end = 0.0
    while end < last:
        for duration, U, share in cycle(rng):
            end += duration
            points.append((end, sign * U, share))
        sign = -sign if both else 1.0
    at, U, share = np.array(points).T
    U, share = np.clip(U, -100, 100), np.clip(share, 0.005, 1.0)
    return lambda t: (np.interp(t, at, U), np.interp(t, at, share))


DEAD_TIME: Final = "dead time of Q"
DEAD_TIMES: Final = 0.05, 0.3  # s
CIRCUMSTANCES: Final = (
    *("coarse U and p", "noise of the reading", "slow noise", "gear pulses", DEAD_TIME),
    *("offset of Q jumps", "offset of dp jumps", "U is noisy", "times jitter", "spikes"),
)


def drawn(seed: int) -> tuple[Row, str]:
    """The plant of a seed, and its description."""
    rng = np.random.default_rng([seed, 36])
    kind, cycle = rng.choice(VALVES), rng.choice(CYCLES)
    there = set(rng.permutation(CIRCUMSTANCES)[: rng.integers(0, 4)])
    fs, both = float(rng.choice(RATES)), kind is servo
    N = int(min(rng.uniform(*SECONDS) * fs, MOST_SAMPLES))
    steps = np.full(N, 1.0 / fs)
    if "times jitter" in there:
        steps *= rng.uniform(0.6, 1.4, N)
    t = np.cumsum(steps)
    top, flow = float(rng.uniform(60, 350)), float(np.exp(rng.uniform(np.log(15), np.log(400))))
    shape = kind(rng)

    def valve(U, dp):
        return flow * shape(U / 100.0, dp / top)

    path = worked(cycle, t[-1], rng, both)
    noise = rng.uniform(0.001, 0.005) * flow
    dead = np.random.default_rng([seed, 37]).uniform(*DEAD_TIMES) if DEAD_TIME in there else 0.0
    U, share = path(t - dead)
    passed = valve(U, top * share)
    shown, sigma, of_Q = _metered(passed, there, (fs, flow, noise), seed, rng)
    U, share = path(t)
    dp = top * share
    seen_U, seen_dp, of_dp = _sensed(U, dp, there, top, rng)
    causes = of_Q | of_dp
    samples = Samples.of((1e9 * t).astype(np.int64), seen_U, seen_dp, 0 * t, shown, 0 * t + 40.0)
    row = Row(
        samples, tuple(int(N * x) for x in MOMENTS), (valve,) * len(MOMENTS),
        U_range=(-100.0 if both else 0.0, 100.0), dp_range=(0.0, top), sigma=sigma,
        causes=frozenset(causes),
    )  # fmt: skip
    words = f"{seed} {kind.__name__}, {cycle.__name__}, {fs:.0f} Hz, {t[-1]:.0f} s"
    return row, f"{words}: {', '.join(sorted(there)) or 'nothing'}"


def _metered(passed, there, sizes, seed, rng):
    """What the meter shows, its σ, and causes; sizes: Hz, largest flow, noise, l/min."""
    N, (fs, flow, noise), causes = len(passed), sizes, set()
    error = noise * (c.ar(seed, N, 0.9, 1.0) if "slow noise" in there else c.white(seed, N, 1.0))
    if "noise of the reading" in there:
        error = (rng.uniform(0.005, 0.015) * np.abs(passed) / noise + 0.2) * error
    if DEAD_TIME in there:
        causes.add(FindingCode.DEAD_TIME)
    if "gear pulses" in there:
        pulse = rng.uniform(0.002, 0.01) * flow / fs
        count = np.floor(np.cumsum((passed + error) / fs) / pulse)
        error = np.diff(count, prepend=count[0]) * pulse * fs - passed
    if "spikes" in there:
        error = np.where(rng.random(N) < 0.003, rng.uniform(-0.2, 1.0, N) * flow - passed, error)
    sigma = c.rms(error[np.abs(error) < 0.1 * flow])
    if "offset of Q jumps" in there:
        causes.add(FindingCode.FLOW_ZERO)
        error = error + _jump(N, 0.02 * flow, rng)
    bits = 3277 / flow  # 12 bits over 1.25 times the range
    return np.round((passed + error) * bits) / bits, sigma, causes


def _sensed(U, dp, there, top, rng):
    """U and Δp as they are measured, and causes."""
    N, causes = len(U), set()
    if "offset of dp jumps" in there:
        causes.add(FindingCode.PRESSURE_ZERO)
        dp = dp + _jump(N, 0.02 * top, rng)
    if "U is noisy" in there:
        U = U + rng.uniform(0.05, 0.3) * rng.standard_normal(N)
    dp = dp + 0.001 * top * rng.standard_normal(N)
    if "coarse U and p" in there:
        of_U, of_p = rng.uniform(0.1, 0.4), rng.uniform(0.001, 0.005) * top
        U, dp = np.round(U / of_U) * of_U, np.round(dp / of_p) * of_p
    return U, dp, causes


def _jump(N, size, rng):
    return size * rng.choice([-1, 1]) * (np.arange(N) >= rng.uniform(0.35, 0.55) * N)
