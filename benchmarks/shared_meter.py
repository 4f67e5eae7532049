"""Three valves behind one flow meter: ``python -m benchmarks.shared_meter --seeds N [--report]``.

A line per seed: the error of each valve's map inside its data (cells of 5 % and 1 √bar with 20
samples), in σ, from the common meter and from a meter each, and their ratio. ``--report`` takes
seeds that nothing is tuned on. ``--leak`` gives the first valve a leakage, the second half of it.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from benchmarks.directional_plant import GAINS, OVERLAPS, SIGMA, Floats
from valvemap.app.build import build_identification
from valvemap.config.loading import load_config
from valvemap.config.models import Config
from valvemap.model.samples import Samples
from valvemap.pipeline import lane_predictions
from valvemap.pipeline.edges import gathered
from valvemap.pipeline.identification import Identification

REPORT: Final = 98_000
RATE_HZ: Final = 100.0
SECONDS: Final = 200.0
ALONE: Final = 0.48  # planned share of one valve alone; moves apart, 0.4 of the time
VALVES: Final = ("PA", "AT", "PB")  # their laws are those of a directional valve's edges
LEAKS: Final = {"PA": 1.0, "AT": 0.5, "PB": 0.0}  # shares of the leakage
_NODES: Final = ("U", "p1", "p2", "T")


def config_of(*, shared: bool, estimator: str = "Auto") -> Config:
    """Return the configuration of the valves, with one meter or one each."""
    text = ""
    for name in VALVES:
        nodes = "\n".join(f"{n} = 's={name}.{n}'" for n in _NODES)
        meter = "s=Q" if shared else f"s={name}.Q"
        text += f"[[valves]]\nname = '{name}'\n[valves.nodes]\n{nodes}\nQ = '{meter}'\n"
        text += f"[[valves.estimators]]\nkind = '{estimator}'\n"
    with TemporaryDirectory() as folder:
        file = Path(folder) / "valves.toml"
        file.write_text(text)
        return load_config(file)


def flow(name: str, U: Floats, dp: Floats, leak: float = 0.0) -> Floats:
    """Return a valve's true flow, l/min; ``leak`` in l/min/√bar."""
    opening = np.clip((U - OVERLAPS[name]) / (100.0 - OVERLAPS[name]), 0.0, 1.0)
    gain = GAINS[name](opening) + LEAKS[name] * leak
    return np.asarray(gain * np.sign(dp) * np.sqrt(np.abs(dp)))


def work(seed: int, seconds: float = SECONDS, leak: float = 0.0) -> dict[str, dict[str, Floats]]:
    """Return machine work of three valves on one pump: signals and true flow by valve."""
    rng = np.random.default_rng([38, seed])
    n = round(seconds * RATE_HZ)
    t = np.arange(n) / RATE_HZ
    wanted, at = np.zeros((len(VALVES), n)), 0
    alone = 0
    while at < n:
        stay = round(rng.uniform(0.4, 3.0) * RATE_HZ)
        is_alone = alone <= ALONE * at
        open_ = rng.permutation(len(VALVES))[: 1 if is_alone else rng.integers(2, 4)]
        for m in open_:
            fine = rng.random() < 0.3
            wanted[m, at : at + stay] = rng.uniform(6, 25) if fine else rng.uniform(10, 100)
        at, alone = at + stay, alone + stay * is_alone
    U = np.array([_slewed(own, rng.uniform(100.0, 300.0) / RATE_HZ) for own in wanted])
    supply = 180.0 - 6.0 * U.sum(axis=0) / 100.0 + 2.0 * np.sin(0.7 * t)
    found = {}
    for name, own in zip(VALVES, U, strict=True):
        slow, fast, phase = rng.uniform(0.3, 1.0), rng.uniform(1.0, 3.0), rng.uniform(0, 6)
        load = 70.0 + 45.0 * np.sin(slow * t + phase) + 15.0 * np.sin(fast * t)
        noise = rng.normal(0.0, 0.1, (2, n))
        found[name] = {
            "U": own, "p1": supply + noise[0], "p2": load + noise[1], "T": np.full(n, 42.0),
            "flow": flow(name, own, supply - load, leak),
        }  # fmt: skip
    return found


def _slewed(wanted: Floats, rate: float) -> Floats:
    found, now = [], 0.0
    for target in wanted.tolist():
        now += min(max(target - now, -rate), rate)
        found.append(now)
    return np.array(found)


def feed(
    identification: Identification, rows: dict[str, dict[str, Floats]], seed: int, *, shared: bool
) -> None:
    """Let all valves learn, from the sum of their flows or from each one's own."""
    rng = np.random.default_rng([39, seed])
    n = len(rows[VALVES[0]]["U"])
    t = np.round(np.arange(n) / RATE_HZ * 1e9).astype(np.int64) + 10**18
    noise = rng.normal(0.0, SIGMA, (len(VALVES), n))
    total = sum((own["flow"] for own in rows.values()), np.zeros(n)) + noise[0]
    for first in range(0, n, 1_000):
        part = slice(first, first + 1_000)
        parts = {}
        for number, (own, wrong) in enumerate(zip(rows.values(), noise, strict=True)):
            Q = total if shared else own["flow"] + wrong
            signals = {name: own[name][part] for name in _NODES}
            parts[number] = Samples.of(t=t[part], Q=Q[part], **signals)
        identification.learn(gathered(parts))


def errors(
    identification: Identification,
    rows: dict[str, dict[str, Floats]],
    estimator: str = "Auto",
    leak: float = 0.0,
) -> dict[str, tuple[float, float]]:
    """Return the RMSE of each valve's map inside its data, in σ, and the share held."""
    found = {}
    for name, own in rows.items():
        U, dp = own["U"], own["p1"] - own["p2"]
        opened = (U > 1.0) & (dp > 0.0)
        places = np.column_stack([U[opened] // 5.0, np.sqrt(dp[opened]) // 1.0])
        cells, counts = np.unique(places, axis=0, return_counts=True)
        cells = cells[counts >= 20]
        at_U, at_dp = cells[:, 0] * 5.0 + 2.5, (cells[:, 1] + 0.5) ** 2
        lane = identification.valves.lane(name, estimator)
        Q, std, _ = lane_predictions.predicted(lane, at_U, at_dp, np.full(len(at_U), 42.0))
        error = Q - flow(name, at_U, at_dp, leak)
        rmse = float(np.sqrt(np.mean(error**2)) / SIGMA)
        found[name] = rmse, float((np.abs(error) <= 1.96 * std).mean())
    return found


def rows_of(seed: int, leak: float = 0.0) -> Iterator[str]:
    """Compare the maps from one meter with those from a meter each."""
    rows = work(seed, leak=leak)
    alone = sum(own["U"] > 1.0 for own in rows.values()) == 1
    found = {}
    for shared in (True, False):
        identification = build_identification(config_of(shared=shared))
        feed(identification, rows, seed, shared=shared)
        found[shared] = errors(identification, rows, leak=leak)
    ratio = [found[True][name][0] / found[False][name][0] for name in VALVES]
    said = ", ".join(
        f"{name} {found[True][name][0]:.3f} σ ({found[True][name][1]:.2f}) beside "
        f"{found[False][name][0]:.3f} σ ({found[False][name][1]:.2f})"
        for name in VALVES
    )
    whole = [np.sqrt(np.mean([found[s][n][0] ** 2 for n in VALVES])) for s in (True, False)]
    yield (
        f"{said}; {whole[0] / whole[1]:.2f} x a meter each ({min(ratio):.2f} … {max(ratio):.2f}); "
        f"one alone {alone.mean():.0%} of the time"
    )


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--report", action="store_true")
    parser.add_argument("--first", type=int, help="first seed, in place of these")
    parser.add_argument("--leak", type=float, default=0.0, help="l/min/√bar")
    given = parser.parse_args()
    first = (REPORT if given.report else 1) if given.first is None else given.first
    for seed in range(first, first + given.seeds):
        for said in rows_of(seed, given.leak):
            print(f"{seed}: {said}", flush=True)


if __name__ == "__main__":
    main()
