"""Which thresholds of `Auto` matter: each halved and doubled, ``python -m benchmarks.sensitivity``.

``[MODULE…]`` follow: of these alone, else of all that are python; ``kernels`` means those of the
compiled loops, each of which is compiled anew, so that takes hours. Writes
``results/sensitivity.json``, which keeps what was tried before as long as `Auto` stays the same,
and ``docs/sensitivity.md``: those that move a figure by more than a tenth. ``page`` as a module
tries nothing.
"""

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.thresholds import KERNELS, PURE, change, source, thresholds

Floats = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "sensitivity.json"
PAGE = ROOT / "docs" / "sensitivity.md"
MOVED: Final = 0.1  # share of a figure that counts as moved
FACTORS: Final = 0.5, 2.0
SEEDS: Final = 3
N, CHANGED_AT, LOST = 10_000, 6_000, 0.08  # samples; when the valve loses a share of its flow
SPACING: Final = 10_000_000  # ns: 100 Hz
SIGMA: Final = 0.4  # l/min, noise of Q
METER_LAG: Final = 0.06  # s

INTRODUCTION = """# Sensitivity

Made by `python -m benchmarks.sensitivity`; do not edit. Every threshold of `Auto` is halved and
doubled, on a valve with dead band and saturation, a sudden loss of flow, and a meter that lags.
Here are those that move a figure by more than a tenth, with the figure over what it is without.
1.00 is no difference, larger is worse; *fails* is an error.
"""

Record = Mapping[str, Any]


def figures() -> dict[str, float]:
    """What the thresholds are held against, of a few valves; all of it the same on any machine."""
    learnt = [_learnt(seed) for seed in range(SEEDS)]
    found: dict[str, float] = {}
    for name in learnt[0]:
        found[name] = float(np.mean([one[name] for one in learnt]))
    return found


def _learnt(seed: int) -> dict[str, float]:
    from benchmarks.auto_speed import ramps_and_holds  # noqa: PLC0415 - after a change
    from valvemap.model.auto import Auto  # noqa: PLC0415
    from valvemap.model.kernels import cells  # noqa: PLC0415
    from valvemap.model.samples import Samples  # noqa: PLC0415

    rng = np.random.default_rng(seed)
    U, dp = ramps_and_holds(rng, N, 0, 100), ramps_and_holds(rng, N, 3, 195)
    auto, said = Auto(), {}
    grid = [x.ravel() for x in np.meshgrid(np.linspace(5, 95, 19), np.linspace(10, 180, 9))]

    def samples_of(Q: Floats) -> Samples:
        return Samples.of(SPACING * np.arange(N), U, dp, 0.0 * dp, Q)

    def error(state: Any, share: float) -> float:
        Q, _ = auto.predict(state, *grid, np.full(len(grid[0]), 40.0))
        return float(np.sqrt(np.nanmean((Q - share * _flow(*grid)) ** 2))) / SIGMA

    steady = samples_of(_flow(U, dp) + SIGMA * rng.standard_normal(N))
    state, _ = auto.update(auto.initial_state(), steady[:1_000])
    said["map after 1,000 samples, σ"] = error(state, 1.0)
    state, _ = auto.update(state, steady[1_000:])
    said["map after 10,000 samples, σ"] = error(state, 1.0)
    said["work, µs per sample"] = float(state.counters[cells.SPENT]) / 1e3 / N
    said["false alarms and 1"] = 1.0 + float(state.counters[cells.ALARMS])
    share = np.where(np.arange(N) < CHANGED_AT, 1.0, 1.0 - LOST)
    changed = samples_of(share * _flow(U, dp) + SIGMA * rng.standard_normal(N))
    state, _ = auto.update(auto.initial_state(), changed[:CHANGED_AT])
    before, at = int(state.counters[cells.ALARMS]), CHANGED_AT
    while at < N and state.counters[cells.ALARMS] == before:
        state, _ = auto.update(state, changed[at : at + 10])
        at += 10
    said["change found after, samples"] = float(at - CHANGED_AT)
    state, _ = auto.update(state, changed[at:])
    said["map 4,000 samples after a change, σ"] = error(state, 1.0 - LOST)
    late = _behind(_flow(U, dp), METER_LAG) + SIGMA * rng.standard_normal(N)
    state, _ = auto.update(auto.initial_state(), samples_of(late))
    said["lag of the meter off by, ms, and 1"] = 1.0 + 1e3 * abs(auto.lags(state)[1] - METER_LAG)
    said["map behind a meter that lags, σ"] = error(state, 1.0)
    return said


def _flow(U: Floats, dp: Floats) -> Floats:
    """A valve with a dead band of 6 % that saturates at 93 %."""
    opening = np.clip((U - 6.0) / 87.0, 0.0, 1.0)
    return np.asarray(13.0 * opening * (1.1 - 0.1 * opening) * np.sqrt(dp))


def _behind(Q: Floats, tau: float) -> Floats:
    """What a meter of first order shows of Q at 100 Hz."""
    shown, share = Q.copy(), -np.expm1(-0.01 / tau)
    for k in range(1, len(Q)):
        shown[k] = shown[k - 1] + share * (Q[k - 1] - shown[k - 1])
    return shown


def page(record: Record) -> str:
    """The page, all of it from the record: figures unchanged, what was tried, what moves them."""
    base, tried = record["base"], record["tried"]
    if not tried:
        return f"{INTRODUCTION}\nNothing has been tried yet of `Auto` as it is.\n"
    modules = dict.fromkeys(threshold.rpartition(".")[0] for threshold in tried)
    lines = [INTRODUCTION, "| figure | unchanged |", "|---|---|"]
    lines += [f"| {name} | {value:.3g} |" for name, value in base.items()]
    names = ", ".join(f"`{module}`" for module in modules)
    lines += ["", f"Tried: {len(tried)} thresholds of {names}.", ""]
    lines += ["| threshold | times | moves |", "|---|---|---|"]
    for threshold, outcomes in tried.items():
        for factor, found in outcomes.items():
            what = _moved(found, base)
            if what:
                lines.append(f"| `{threshold}` | {factor} | {what} |")
    return "\n".join(lines) + "\n"


def _moved(found: Mapping[str, float], base: Mapping[str, float]) -> str:
    """Which figures are others by more than a tenth, in words; none where it failed."""
    ratios = {name: value / base[name] for name, value in found.items()}
    moved = [f"{name}: {x:.2f}" for name, x in ratios.items() if abs(x - 1.0) > MOVED]
    return ", ".join(moved) if found else "*fails*"


def _measured(module: str, name: str, factor: float) -> Mapping[str, float]:
    """Figures of a process of its own; empty where it fails."""
    command = [sys.executable, "-m", "benchmarks.sensitivity", "one", module, name, str(factor)]
    with tempfile.TemporaryDirectory() as cache:
        own = {"NUMBA_CACHE_DIR": cache} if module.startswith("kernels") else {}
        done = subprocess.run(
            command, env=os.environ | own, capture_output=True, text=True, check=False
        )
    return json.loads(done.stdout) if done.returncode == 0 else {}


def _sources() -> str:
    """A hash of all that is `Auto`."""
    text = "".join(source(module) for module in (*PURE, *KERNELS))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _try(modules: Sequence[str], before: Record) -> Record:
    """Halve and double their thresholds, those not tried yet, several at a time."""
    sources = _sources()
    record: dict[str, Any] = (
        dict(before)
        if before.get("sources") == sources
        else {"sources": sources, "base": figures(), "tried": {}}
    )
    tried = record["tried"]
    due = [(m, name) for m, name in thresholds(modules) if f"{m}.{name}" not in tried]

    def both(threshold: tuple[str, str]) -> dict[str, Mapping[str, float]]:
        return {str(factor): _measured(*threshold, factor) for factor in FACTORS}

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for (module, name), outcomes in zip(due, pool.map(both, due), strict=True):
            tried[f"{module}.{name}"] = outcomes
            for factor, found in outcomes.items():
                what = _moved(found, record["base"]) or "moves nothing"
                print(f"{module}.{name} x {factor}: {what}", flush=True)
            RESULTS.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", "utf-8")
    return record


def main(arguments: Sequence[str]) -> int:
    """Measure one change, or all that is asked for, and write the page."""
    if arguments[:1] == ["one"]:
        module, name, factor = arguments[1:]
        change(module, name, float(factor))
        print(json.dumps(figures()))
        return 0
    asked = [m for one in arguments for m in (KERNELS if one == "kernels" else (one,))]
    unknown = set(asked) - {*PURE, *KERNELS, "page"}
    if unknown:
        print(f"{', '.join(sorted(unknown))}: no module of Auto", file=sys.stderr)
        return 2
    record = json.loads(RESULTS.read_text("utf-8")) if RESULTS.exists() else {}
    if asked != ["page"]:
        record = _try(asked or PURE, record)
    PAGE.write_text(page(record), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
