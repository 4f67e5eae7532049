"""What `Auto` costs, alone and in the default configuration.

``python -m benchmarks.auto_speed [VALVES SAMPLES]`` prints samples per second of one core: `Auto`
alone, the first thousand samples of a valve and those after them, on scattered points and on a
machine's cycle; then the default configuration, replayed from Parquet; and what a valve holds.
"""

import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.measured_data import Floats
from benchmarks.speed_page import AUTO
from valvemap.app.replay import replay
from valvemap.config.estimators import build_estimator, default_estimators
from valvemap.model.estimator import Estimator, State
from valvemap.model.flow_map import FlowMap
from valvemap.model.residual_spread import ResidualSpread
from valvemap.model.samples import Samples
from valvemap.storage.recording_writer import RecordingWriter

Figures = Mapping[str, float]

START, SPACING = 1_700_000_000_000_000_000, 10_000_000  # ns: 100 Hz
YOUNG: Final = 1_000  # samples
BATCH: Final = 250  # samples in a call: 2.5 s of 100 Hz
SIGMA: Final = 0.4  # l/min


def ramps_and_holds(rng: np.random.Generator, N: int, low: float, high: float) -> Floats:
    """What a machine does at 100 Hz: ramps between random levels, held in between."""
    t, x = [0.0], [rng.uniform(low, high)]
    while t[-1] < N:
        ramp, hold, level = rng.uniform(40, 300), rng.uniform(0, 100), rng.uniform(low, high)
        t += [t[-1] + ramp, t[-1] + ramp + hold]
        x += [level, level]
    return np.interp(np.arange(N), t, x)


def recording(kind: str, seed: int, N: int) -> Samples:
    """A valve of 6 % dead band and a slightly bent gain."""
    rng = np.random.default_rng(seed)
    if kind == "scattered":
        U, dp = rng.uniform(0, 100, N), rng.uniform(2, 198, N)
    else:
        U, dp = ramps_and_holds(rng, N, 0, 100), ramps_and_holds(rng, N, 3, 195)
    opening = np.clip((U - 6) / 94, 0, 1)
    Q = 13 * opening * (1.1 - 0.1 * opening) * np.sqrt(dp) + SIGMA * rng.standard_normal(N)
    t = START + SPACING * np.arange(N)
    return Samples.of(t, U, dp + 5.0, np.full(N, 5.0), Q, np.full(N, 40.0))


def alone(kind: str, valves: int, N: int) -> Figures:
    """Samples per second of CPU time, while a map is young and afterwards."""
    auto, spent = FlowMap(), np.zeros(2)
    for seed in range(valves):
        samples, state = recording(kind, seed, N), auto.initial_state()
        for start in range(0, N, BATCH):
            began = time.process_time()
            state, _ = auto.update(state, samples[start : start + BATCH])
            spent[int(start >= YOUNG)] += time.process_time() - began
    young, settled = valves * np.array([YOUNG, N - YOUNG]) / spent
    return {"first 1,000 samples": young, "after them": settled}


def measured(valves: int = 10, N: int = 10_000) -> Mapping[str, Figures]:
    """Samples per second of `Auto` alone, on scattered points and on a machine's cycle."""
    alone("cycle", 1, 2 * YOUNG)  # compiles
    speeds = {kind: alone(kind, valves, N) for kind in ("scattered", "cycle")}
    return {
        AUTO: {f"{kind}: {when}": v for kind in speeds for when, v in speeds[kind].items()},
    }


def default_configuration(valves: int, N: int) -> Figures:
    """Samples per second of CPU time: replay of all valves from Parquet."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "fleet.parquet"
        with RecordingWriter(file) as writer:
            for v in range(valves):
                writer.append(f"V{v}", recording("cycle", v, N))
        began = time.process_time()
        replay([file])
        return {"replay": valves * N / (time.process_time() - began)}


def memory() -> Figures:
    """kB that a valve's estimators and the spread of their residuals hold."""
    spread, found = ResidualSpread.none(), {}
    for config in default_estimators():
        estimator: Estimator[Any] = build_estimator(config, (0, 100), (0, 200), (0, 200))
        found[config.name] = size_of(estimator.initial_state())
        found["spreads"] = found.get("spreads", 0.0) + size_of(spread)
    found["all"] = sum(found.values())
    return {name: size / 1000.0 for name, size in found.items()}


def size_of(state: State | ResidualSpread) -> float:
    """Bytes of a state's arrays."""
    return float(sum(np.asarray(getattr(state, f.name)).nbytes for f in fields(state)))


def main(arguments: Sequence[str]) -> int:
    """Measure and print."""
    valves, N = map(int, arguments) if arguments else (100, 10_000)
    tables = {
        "Memory of a valve, kB": memory(),
        **measured(max(2, valves // 10), N),
        f"Default configuration, {valves} valves x {N:,}, samples/s": default_configuration(
            valves, N
        ),
    }
    for title, figures in tables.items():
        print(title)
        for name, figure in figures.items():
            print(f"  {name:24} {figure:14,.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
