"""How honest the default RLS is where its structure misfits: ``python -m benchmarks.honest_maps``.

Prints, with other seeds than the tests: the error of the map (in sigma, beside what is demanded),
what `Adaptation` says, how late -10 % damage is found (samples with Q > 10 l/min), how many changes
are called in healthy samples, and how often the 95 % interval holds the true flow.
"""

import argparse
import sys
from collections.abc import Callable, Iterator

import numpy as np

from benchmarks import circumstances as c
from service.identification.forgetting import Adaptive
from service.identification.least_squares_state import RlsState
from service.identification.recursive_least_squares import RecursiveLeastSquares
from service.identification.samples import Floats

RLS = RecursiveLeastSquares(forgetting=Adaptive())
VALVES = {
    "eq. (7)": c.eq7,
    "ordinary": c.ordinary,
    "dead band": c.dead_band,
    "S-shape": c.s_shape,
    "saturating": c.saturating,
    "laminar": c.laminar,
}
DRIFTING, WEARING, HEALTHY, SHORT = 180_000, 360_000, 300_000, 30_000  # samples
BEFORE, AFTER, STEP = 10_000, 3_000, 5  # samples around the damage, and per batch after it

Stream = tuple[Floats, Floats, Floats, Floats | float]


def learnt(U: Floats, dp: Floats, Q: Floats, T: Floats | float = 40.0) -> RlsState:
    """State after N samples."""
    return RLS.update(RLS.initial_state(), c.samples_of(U, dp, Q, T))[0]


def figure(state: RlsState, U: Floats, dp: Floats, truth: c.Valve, slack: float) -> str:
    """Error over the visited region, what is demanded, what the estimator says."""
    region = c.inside(U, dp)
    Q, _ = RLS.predict(state, region.U, region.dp, region.T)
    error = c.rms(Q - truth(region.U, region.dp)) / c.SIGMA
    _, best = c.best_eq7(region, truth)
    demanded = 1.3 * best / c.SIGMA + slack
    return f"{error:.2f} ({demanded:.2f}) {RLS.adaptation(state).name}"


def structured(valve: c.Valve, seed: int) -> str:
    """U in steps."""
    U, dp = c.structured()
    return figure(learnt(U, dp, valve(U, dp) + c.white(seed, len(U))), U, dp, valve, 0.0)


def drift(valve: c.Valve, seed: int) -> str:
    """Gain that drifts by -15 %/h, on a cycle."""
    U, dp = c.cycle(seed, DRIFTING)
    factor = c.drift(DRIFTING)
    state = learnt(U, dp, valve(U, dp) * factor + c.white(seed, DRIFTING))
    return figure(state, U, dp, lambda U, dp: factor[-1] * valve(U, dp), 0.5)


def edge(valve: c.Valve, seed: int) -> str:
    """An edge that wears within an hour, on a cycle."""
    U, dp = c.cycle(seed, WEARING)
    worn = c.wear(WEARING) * c.worn_edge(U, dp)
    state = learnt(U, dp, valve(U, dp) + worn + c.white(seed, WEARING))
    return figure(state, U, dp, lambda U, dp: valve(U, dp) + c.worn_edge(U, dp), 0.5)


def damage(valve: c.Valve, seed: int, points: Callable[[int, int], tuple[Floats, Floats]]) -> str:
    """Samples with Q > 10 l/min from -10 % damage until it is found."""
    U, dp = points(seed, BEFORE + AFTER)
    factor = np.where(np.arange(len(U)) < BEFORE, 1.0, 0.9)
    flow = valve(U, dp) * factor
    samples = c.samples_of(U, dp, flow + c.white(seed, len(U)))
    state, _ = RLS.update(RLS.initial_state(), samples[:BEFORE])
    for first in range(BEFORE, len(U), STEP):
        state, _ = RLS.update(state, samples[first : first + STEP])
        if RLS.last_change(state) is not None:
            return str(int((flow[BEFORE : first + STEP] > 10.0).sum()))
    return "not"


def healthy(valve: c.Valve, seed: int) -> Iterator[tuple[str, Stream]]:
    """Streams in which nothing changes but the temperature."""
    U, dp = c.cycle(seed, HEALTHY)
    Q, white = valve(U, dp), c.white(seed, HEALTHY)
    yield "white", (U, dp, Q + white, 40.0)
    yield "AR(.95)", (U, dp, Q + c.ar(seed, HEALTHY), 40.0)
    T = c.warming(HEALTHY)
    yield "warming", (U, dp, c.warm(valve)(U, dp, T) + white, T)
    U, dp = c.scattered(seed, HEALTHY)
    yield "scattered", (U, dp, valve(U, dp) + white, 40.0)
    U, dp = (np.resize(x, HEALTHY) for x in c.structured())
    yield "structured", (U, dp, valve(U, dp) + white, 40.0)
    yield "closed loop", (*c.closed_loop(seed, HEALTHY, valve), 40.0)


def false_changes(seeds: range) -> dict[str, int]:
    """Changes called per circumstance, over all valves."""
    found: dict[str, int] = {}
    for valve in VALVES.values():
        for seed in seeds:
            for name, stream in healthy(valve, seed):
                change = RLS.last_change(learnt(*stream))
                found[name] = found.get(name, 0) + (change.count if change else 0)
    return found


def coverage(name: str, seeds: range) -> tuple[float, float]:
    """Share of the visited region whose true flow the 95 % interval holds; its width, l/min."""
    held, widths = [], []
    for seed in seeds:
        U, dp = c.cycle(seed, SHORT)
        noise = c.ar(seed, SHORT) if name == "AR(.95)" else c.white(seed, SHORT)
        factor = c.drift(SHORT) if name == "drift" else np.ones(SHORT)
        if name == "reacting":
            U = c.reacting(U, noise)
        state = learnt(U, dp, c.eq7(U, dp) * factor + noise)
        region = c.inside(U, dp)
        Q, std = RLS.predict(state, region.U, region.dp, region.T)
        error = Q - c.eq7(region.U, region.dp) * factor[-1]
        held.append(np.mean(np.abs(error) <= c.TWO_SIDED_95 * std))
        widths.append(2.0 * c.TWO_SIDED_95 * np.mean(std))
    return float(np.mean(held)), float(np.mean(widths))


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=200)
    wanted = parser.parse_args()
    seeds = range(wanted.first, wanted.first + wanted.seeds)
    write = sys.stdout.write
    for title, measure in (("structured", structured), ("drift", drift), ("edge", edge)):
        for name, valve in VALVES.items():
            write(f"{title:10} {name:10} {'; '.join(measure(valve, s) for s in seeds)}\n")
    for title, points in (("cycle", c.cycle), ("scattered", c.scattered)):
        for name, valve in VALVES.items():
            write(f"-10 % {title} {name}: {[damage(valve, s, points) for s in seeds]}\n")
    for name in ("white", "AR(.95)", "drift", "reacting"):
        share, width = coverage(name, seeds)
        write(f"eq. (7) {name}: true flow held {share:.3f}, width {width:.3f} l/min\n")
    write(f"false changes in {HEALTHY} samples each: {false_changes(seeds)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
