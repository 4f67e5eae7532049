"""Valves with ports: ``python -m benchmarks.edges --seeds N [--only ROW] [--report]``.

A line per row and seed. *rmse* is that of an edge's map inside its data (cells of 5 % and 1 √bar
with 20 samples) in σ, *held* the share of true flows inside the 95 % interval. ``--report`` takes
seeds that nothing is tuned on; ``--first`` any.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from benchmarks import directional_plant as plant
from valvemap.app.build import build_identification
from valvemap.config.loading import load_config
from valvemap.config.models import Config
from valvemap.config.valves import ValveConfig
from valvemap.model.samples import Floats, Samples
from valvemap.pipeline import lane_predictions
from valvemap.pipeline.edges import gathered
from valvemap.pipeline.identification import Identification
from valvemap.vocabulary.edges import Edge
from valvemap.vocabulary.statuses import InverseStatus
from valvemap_rig.directional import true_edge_flow
from valvemap_rig.scenario import load_scenario
from valvemap_rig.simulation import advance, initial

REPORT: Final = 97_000
RATE_HZ: Final = 100.0
ESTIMATOR: Final = "Auto"
NODES: Final = ("U", "pP", "pT", "pA", "pB", "QA", "QB", "T")
TOML: Final = "[[valves]]\nname = 'V'\n[valves.ports]\n{}\n[[valves.estimators]]\nkind = '{}'\n"

Recording = dict[str, Floats]


def config_of(estimator: str = ESTIMATOR) -> Config:
    """Return the configuration of one valve with four edges."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "ports.toml"
        file.write_text(TOML.format("\n".join(f"{n} = 's=V.{n}'" for n in NODES), estimator))
        return load_config(file)


def recorded(valve: plant.Valve, seconds: float, seed: int) -> Recording:
    """Return machine work on a valve."""
    rng = np.random.default_rng(seed)
    return plant.measured(valve, *plant.work(seconds, RATE_HZ, rng), RATE_HZ, rng)


def feed(identification: Identification, config: Config, rows: Recording, start: float) -> None:
    """Let all edges and lines learn a recording that begins ``start`` s after the first."""
    t = np.round((rows["t"] + start) * 1e9).astype(np.int64)
    parts = {}
    for number, valve in enumerate(config.valves):
        nodes = {name: valve.nodes.of(name) for name in ("U", "p1", "p2", "Q", "T")}
        columns = {name: rows[str(node).rpartition(".")[2]] for name, node in nodes.items()}
        parts[number] = Samples.of(t=t, **columns)
    identification.learn(gathered(parts))


def cells(rows: Recording, edge: Edge) -> tuple[Floats, Floats]:
    """Return the middles (U, Δp) of the cells in which an edge has samples."""
    U, dp = rows["U"] * edge.opens, rows[f"p{edge.of}"] - rows[f"p{edge.to}"]
    used = (U > 0.0) & (dp > 0.0)
    places = np.column_stack([U[used] // 5.0, np.sqrt(dp[used]) // 1.0])
    found, counts = np.unique(places, axis=0, return_counts=True)
    found = found[counts >= 20]
    return found[:, 0] * 5.0 + 2.5, (found[:, 1] + 0.5) ** 2


def judged(
    identification: Identification, valve: plant.Valve, rows: Recording, edge: Edge
) -> tuple[float, float]:
    """Return RMSE in σ and the share held of one edge's map."""
    lane = identification.valves.lane(f"V.{edge}", ESTIMATOR)
    U, dp = cells(rows, edge)
    Q, std, _ = lane_predictions.predicted(lane, U, dp, np.full(len(U), 42.0))
    error = Q - valve.flow(edge, U, dp)
    return (
        float(np.sqrt(np.mean(error**2)) / plant.SIGMA),
        float((np.abs(error) <= 1.96 * std).mean()),
    )


def accuracy(seed: int) -> Iterator[str]:
    """Error of each edge and of the leakage after 200 and 600 s."""
    valve, config = plant.Valve(), config_of()
    rows, identification = recorded(valve, 600.0, seed), build_identification(config)
    begin = 0
    for end in (200, 600):
        some = {name: x[round(begin * RATE_HZ) : round(end * RATE_HZ)] for name, x in rows.items()}
        feed(identification, config, some, 0.0)
        seen = {name: x[: round(end * RATE_HZ)] for name, x in rows.items()}
        found = [(edge, *judged(identification, valve, seen, edge)) for edge in Edge]
        said = ", ".join(f"{edge} {rmse:.2f} σ ({held:.2f})" for edge, rmse, held in found)
        lost = []
        for line in "AB":
            lane = identification.valves.lane(f"V.Line{line}", "Leak")
            c, std = lane.estimator.parameters(lane.state)
            lost.append(f"{c[0] / valve.leakage - 1.0:+.1%} ± {std[0] / valve.leakage:.1%}")
        yield f"{end} s: {said}; leakage {', '.join(lost)}"
        begin = end


def rig(seed: int) -> Iterator[str]:
    """The same on the virtual rig's scenario `directional`, whose meters have the same noise."""
    scenario = load_scenario("directional").model_copy(update={"seed": seed})
    (machine,) = scenario.machines
    _, block = advance(scenario, initial(scenario, 0), round(600.0 * scenario.sample_rate_hz))
    shown = block.machines[machine.name].shown
    rows = {name: shown[name] for name in NODES} | {"t": block.machines[machine.name].t * 1e-9}
    config = config_of()
    identification, begin = build_identification(config), 0
    for end in (200, 600):
        some = {name: x[round(begin * RATE_HZ) : round(end * RATE_HZ)] for name, x in rows.items()}
        feed(identification, config, some, 0.0)
        said = []
        for edge in Edge:
            lane = identification.valves.lane(f"V.{edge}", ESTIMATOR)
            U, dp = cells({name: x[: round(end * RATE_HZ)] for name, x in rows.items()}, edge)
            Q, std, _ = lane_predictions.predicted(lane, U, dp, np.full(len(U), 40.0))
            error = Q - true_edge_flow(machine.valve, edge.name, U, dp)  # type: ignore[arg-type]
            rmse, held = np.sqrt(np.mean(error**2)) / plant.SIGMA, np.abs(error) <= 1.96 * std
            said.append(f"{edge} {rmse:.2f} σ ({held.mean():.2f})")
        lanes = [identification.valves.lane(f"V.Line{line}", "Leak") for line in "AB"]
        lost = [lane.estimator.parameters(lane.state)[0][0] for lane in lanes]
        shares = [c / machine.valve.leakage_l_min_bar - 1.0 for c in lost]
        yield f"{end} s: {', '.join(said)}; leakage {', '.join(f'{x:+.1%}' for x in shares)}"
        begin = end


def change(seed: int) -> Iterator[str]:
    """Time of use after which -10 % at one edge is named, and the findings at the others."""
    valve, config = plant.Valve(), config_of()
    identification = build_identification(config)
    feed(identification, config, recorded(valve, 300.0, seed), 0.0)
    edge = tuple(Edge)[seed % 4]
    before = {e: _changes(identification, e) for e in Edge}
    rows, used = recorded(plant.worn(valve, edge, 0.9), 120.0, seed + 1), 0.0
    for second in range(120):
        part = slice(round(second * RATE_HZ), round((second + 1) * RATE_HZ))
        some = {name: x[part] for name, x in rows.items()}
        feed(identification, config, some, 300.0)
        used += float((some["U"] * edge.opens > plant.OVERLAPS[edge] + 5.0).sum()) / RATE_HZ
        if _changes(identification, edge) > before[edge]:
            break
    others = sum(_changes(identification, e) - before[e] for e in Edge if e != edge)
    yield f"{edge} named after {used:.1f} s of use; changes at others {others}, before {before}"


def _changes(identification: Identification, edge: Edge) -> int:
    lane = identification.valves.lane(f"V.{edge}", ESTIMATOR)
    found = lane.estimator.last_change(lane.state)
    return 0 if found is None else int(found.count)


def inverse(seed: int) -> Iterator[str]:
    """1,000 demands over ± the range: edge, error, and the share that is answered."""
    valve, config = plant.Valve(), config_of()
    rows, identification = recorded(valve, 600.0, seed), build_identification(config)
    feed(identification, config, rows, 0.0)
    known = {e: set(zip(*(x.tolist() for x in cells(rows, e)), strict=True)) for e in Edge}
    rng = np.random.default_rng(seed)
    wrong, far, feasible, answered = 0, 0, 0, 0
    for _ in range(1_000):
        line = "AB"[int(rng.integers(2))]
        Q = float(rng.uniform(-120.0, 120.0))
        edge = next(e for e in Edge if e.line == line and e.adds * Q > 0.0)
        row = int(rng.integers(len(rows["t"])))
        dp = float(rows[f"p{edge.of}"][row] - rows[f"p{edge.to}"][row])
        answer = identification.invert(f"V.Line{line}", Q, dp, 42.0)
        U, is_ok = float(answer.U[0]), answer.status[0] == InverseStatus.OK
        wrong += bool(np.isfinite(U) and U * edge.opens < 0.0)
        other = "B" if line == "A" else "A"
        lost = valve.leakage * float(rows[f"p{line}"][-1] - rows[f"p{other}"][-1])
        wanted = abs(Q + lost)
        grid = np.linspace(0.0, 100.0, 2_001)
        true = valve.flow(edge, grid, np.full(2_001, dp))
        place = float(grid[np.argmin(np.abs(true - wanted))])
        there = place // 5.0 * 5.0 + 2.5, (np.sqrt(max(dp, 0.0)) // 1.0 + 0.5) ** 2
        inside = dp > 0.0 and wanted < true[-1] and there in known[edge]
        feasible += inside
        answered += inside and is_ok
        if is_ok:
            flow = valve.flow(edge, np.array([U]), np.array([dp]))[0]
            far += bool(abs(flow - wanted) > 3.0 * plant.SIGMA)
    yield (
        f"wrong edge {wrong}, OK and off by more than 3 σ {far}, answered "
        f"{answered} of {feasible} feasible inside the data"
    )


def speed(seed: int) -> Iterator[str]:
    """CPU time of four edges and two lines against that of one valve with one edge."""
    valve, config = plant.Valve(), config_of()
    rows = recorded(valve, 120.0, seed)
    one = _single(config)
    edge = {**rows, "U": np.abs(rows["U"]), "QA": np.abs(rows["QA"])}
    spent = {}
    for name, own, some in (("four", config, rows), ("one", one, edge)):
        best = np.inf
        for _ in range(3):
            identification = build_identification(own)
            began = time.process_time()
            for second in range(120):
                part = slice(round(second * RATE_HZ), round((second + 1) * RATE_HZ))
                feed(identification, own, {n: x[part] for n, x in some.items()}, 0.0)
            best = min(best, time.process_time() - began)
        spent[name] = best
    yield f"four edges {spent['four'] / spent['one']:.2f} x one ({spent['one']:.2f} s)"


def _single(config: Config) -> Config:
    """Return the configuration with its edge as a valve with one edge."""
    edge = config.valves[2]
    given = {name: getattr(edge, name) for name in ValveConfig.model_fields}
    valve = ValveConfig.model_construct(**{**given, "name": "V"})
    return config.model_copy(update={"valves": (valve,)})


ROWS: Final[dict[str, Callable[[int], Iterator[str]]]] = {
    "accuracy": accuracy,
    "rig": rig,
    "change": change,
    "inverse": inverse,
    "speed": speed,
}


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--only", choices=ROWS)
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--report", action="store_true")
    given = parser.parse_args()
    first = REPORT if given.report else given.first
    for name, row in ROWS.items():
        if given.only in (None, name):
            for seed in range(first, first + given.seeds):
                for said in row(seed):
                    print(f"{name} {seed}: {said}", flush=True)


if __name__ == "__main__":
    main()
