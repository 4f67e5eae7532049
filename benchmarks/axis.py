"""Four edges, bulk modulus and leakage from a cylinder's position and pressures, on the rig.

``python -m benchmarks.axis [--seeds 3] [--first 100] [--speed] [--wrong]``: one table. Each seed
is another valve (edges, overlaps, play, spool), mass, bulk modulus, leakage and work; positions
with noise of 5 µm, 0.1 mm and 0.5 mm. Errors are in σ = 0.4 l/min over the cells of 5 % and 10 bar
that were visited for half a second. ``metered`` is a fit of the same edges to a meter in each line
without play and spool, as in the trials. ``--speed``: the speed is measured in place of the
position, with noise of 0.5, 2 and 5 mm/s, a zero that is off by 0.2 mm/s at most, and a scale that
is off by 0.1 %. ``--late v=20``: a signal is shown 20 ms late. ``--noise``: of all seeds, in place
of these. ``--wrong``: answers to signals and areas that are wrong, in place of the table.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from valvemap.model.axis import AxisGeometry, AxisSamples
from valvemap.model.axis_basis import COMMON, edge_regressors
from valvemap.model.axis_fit import AxisFit
from valvemap.model.axis_search import AxisResult, identify
from valvemap.model.kernels.axis_rows import COMMAND, PER_DELAY, PISTON
from valvemap.vocabulary.edges import EDGES
from valvemap_rig.directional import OPENS, DirectionalValve, EdgeCurve, true_edge_flow
from valvemap_rig.machine import Cylinder, Machine, MachineSensors
from valvemap_rig.machine_simulation import MachineBlock
from valvemap_rig.scenario import Scenario
from valvemap_rig.sensors import Sensor
from valvemap_rig.simulation import Commands, advance, initial

SIGMA = 0.4
GEOMETRY = AxisGeometry(63, 45, 800, 1.2, 1.2)
NOISES_MM = (0.005, 0.1, 0.5)
NOISES_MM_S = (0.5, 2.0, 5.0)


def machine(seed: int, noise_mm: float = 0.005, **cylinder: float) -> Machine:
    """Return the axis of a seed."""
    rng = np.random.default_rng(seed)

    def edge(K: float) -> EdgeCurve:
        return EdgeCurve(
            K=K * rng.uniform(0.8, 1.2),
            overlap_percent=rng.uniform(3, 10),
            linear_share=rng.uniform(0, 0.7),
            exponent=rng.uniform(1.1, 2.2),
        )

    valve = DirectionalValve(
        PA=edge(12),
        AT=edge(11),
        PB=edge(10),
        BT=edge(9),
        play_percent=rng.uniform(0.5, 6),
        natural_frequency_hz=rng.uniform(25, 70),
        damping=rng.uniform(0.7, 0.9),
        leakage_l_min_bar=0.0,
    )
    drawn = {
        "mass_kg": float(np.exp(rng.uniform(np.log(200), np.log(6000)))),
        "bulk_modulus_GPa": rng.uniform(0.3, 1.6),
        "leakage_l_min_bar": float(np.exp(rng.uniform(np.log(0.001), np.log(0.02)))),
    }
    return Machine(
        name="Axis",
        measures="position",
        valve=valve,
        cylinder=Cylinder(**{**drawn, **cylinder}),
        sensors=MachineSensors(x=Sensor(noise=noise_mm, quantum=0.001)),
    )


def played(
    axis: Machine, seed: int, seconds: float = 300.0, rate: float = 100.0, U: float | None = None
) -> MachineBlock:
    """Return a recording of machine work, or of a held command."""
    scenario = Scenario(seed=seed, valves=(), machines=(axis,), sample_rate_hz=rate)
    commands = Commands(U={} if U is None else {"Axis": U})
    _, block = advance(scenario, initial(scenario, 0), round(seconds * rate), commands)
    return block.machines["Axis"]


def samples(block: MachineBlock, *without: str) -> AxisSamples:
    """Return the samples of a recording, less some signals."""
    shown = {name: values for name, values in block.shown.items() if name not in without}
    return AxisSamples.of(block.t, **shown)


def with_speed(block: MachineBlock, seed: int, noise_mm_s: float | None = None) -> MachineBlock:
    """Return the recording with the speed in place of the position."""
    rng = np.random.default_rng(seed)
    v, noise = block.truth["v"], NOISES_MM_S[seed % 3] if noise_mm_s is None else noise_mm_s
    off, scale = rng.uniform(-0.2, 0.2), 1.0 + 0.001 * rng.standard_normal()
    shown = {name: values for name, values in block.shown.items() if name != "x"}
    return replace(
        block, shown={**shown, "v": scale * v + off + noise * rng.standard_normal(len(v))}
    )


def late(block: MachineBlock, name: str, by_s: float, rate: float = 100.0) -> MachineBlock:
    """Return the recording with a signal that is shown later."""
    n, values = round(by_s * rate), block.shown[name]
    shown = np.concatenate([np.repeat(values[:1], n), values[: len(values) - n]])
    return replace(block, shown={**block.shown, name: shown})


def cells(block: MachineBlock) -> dict[str, tuple[Any, Any]]:
    """Return the centres of the visited cells of each edge: spool position (%), drop (bar)."""
    truth, found = block.truth, {}
    for edge in EDGES:
        high, low = ("pS", f"p{edge[1]}") if edge[0] == "P" else (f"p{edge[0]}", "pT")
        dp, y = truth[high] - truth[low], truth["spool"] * OPENS[edge]
        bins = [np.arange(0, 101, 5), np.arange(0, 301, 10)]
        count, _, _ = np.histogram2d(y[y > 0], dp[y > 0], bins=bins)
        i, j = np.nonzero(count >= 50)
        found[edge] = i * 5 + 2.5, j * 10 + 5.0
    return found


def errors(axis: Machine, block: MachineBlock, fit: AxisFit) -> tuple[Any, Any]:
    """Return errors and their standard deviations over all cells, l/min."""
    off, std = [], []
    for edge, (U, dp) in cells(block).items():
        off.append(fit.flow(edge, U, dp) - true_edge_flow(axis.valve, edge, U, dp))
        std.append(fit.flow_std(edge, U, dp))
    return np.concatenate(off), np.concatenate(std)


def metered(axis: Machine, block: MachineBlock) -> float:
    """Return the error of a static fit to a meter in each line, σ."""
    truth, rng, off = block.truth, np.random.default_rng(7), []
    U, shown = truth["U"], block.shown
    for line, (supply, drain) in (("A", ("PA", "AT")), ("B", ("PB", "BT"))):
        p = shown[f"p{line}"]
        flow = truth[f"Q{line}"] + SIGMA * rng.standard_normal(len(p))
        open_P = (U * OPENS[supply] > 0).astype(float)[:, None]
        open_T = (U * OPENS[drain] > 0).astype(float)[:, None]
        X = np.hstack(
            [
                open_P * edge_regressors(U, shown["pS"] - p),
                -open_T * edge_regressors(U, p - shown["pT"]),
            ]
        )
        theta = np.linalg.solve(X.T @ X + 1e-2 * np.eye(X.shape[1]), X.T @ flow)
        half = X.shape[1] // 2
        for edge, own in ((supply, theta[:half]), (drain, theta[half:])):
            y, dp = cells(block)[edge]
            off.append(edge_regressors(y, dp) @ own - true_edge_flow(axis.valve, edge, y, dp))
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2)) / SIGMA)


def refusals(seed: int) -> list[tuple[str, AxisResult]]:
    """Return what is said of recordings that must be refused."""
    axis = machine(seed)
    block = played(axis, seed)
    held = axis.model_copy(update={"controller": None})
    shifted = {**block.shown, "x": 0 * block.shown["x"] + 799.5}
    return [
        ("10 Hz", identify(samples(played(axis, seed, rate=10.0)), GEOMETRY)),
        ("30 s", identify(samples(block)[:3000], GEOMETRY)),
        ("end stops", identify(samples(played(held, seed, U=40.0)), GEOMETRY)),
        ("piston blocked at its stop", identify(samples(replace(block, shown=shifted)), GEOMETRY)),
        ("p_B missing", identify(samples(block, "pB"), GEOMETRY)),
        ("position and command", identify(samples(block, "pA", "pB", "pS", "pT"), GEOMETRY)),
    ]


def wrong(seed: int) -> Iterator[tuple[str, AxisResult]]:
    """Yield the answers to wrong signs, units, names, zeros, delays and areas."""
    shown = samples(played(machine(seed, NOISES_MM[seed % 3]), seed))
    stroke, late = GEOMETRY.stroke_mm, np.roll(shown.x, 6)
    signals = {
        "as it is": {},
        "U with the wrong sign": {"U": -shown.U},
        "x with the wrong sign": {"x": stroke - shown.x},
        "x in cm": {"x": 0.1 * shown.x},
        "pA in psi": {"pA": 14.5 * shown.pA},
        "pA and pB exchanged": {"pA": shown.pB, "pB": shown.pA},
        "pS and pT exchanged": {"pS": shown.pT, "pT": shown.pS},
        "pA 6 bar high": {"pA": shown.pA + 6.0},
        "x 60 ms late": {"x": late},
    }
    for words, changed in signals.items():
        yield words, identify(replace(shown, **changed), GEOMETRY)
    for words, geometry in (
        ("piston 70 mm", replace(GEOMETRY, piston_mm=70)),
        ("rod 32 mm", replace(GEOMETRY, rod_mm=32)),
    ):
        yield words, identify(shown, geometry)


def drawn(seed: int, options: argparse.Namespace) -> tuple[float, Machine, MachineBlock]:
    """Return the noise of a seed's position or speed, its axis and its recording."""
    noise = (NOISES_MM_S if options.speed else NOISES_MM)[seed % 3]
    if options.noise is not None:
        noise = options.noise
    axis = machine(seed, NOISES_MM[seed % 3] if options.speed else noise)
    block = played(axis, seed)
    if options.speed:
        block = with_speed(block, seed, noise)
    if options.late:
        name, ms = options.late.split("=")
        block = late(block, name, 1e-3 * float(ms))
    return noise, axis, block


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--speed", action="store_true")
    parser.add_argument("--noise", type=float, help="of position or speed, mm or mm/s")
    parser.add_argument("--late", default="", help="signal=ms")
    parser.add_argument("--wrong", action="store_true")
    options = parser.parse_args()
    if options.wrong:
        for seed in range(options.first, options.first + options.seeds):
            for words, result in wrong(seed):
                print(f"{seed} {words}: {result.status.name}: {result.sentence}", flush=True)
        return
    print(
        "seed  noise   metered static searched coverage   beta (true)  off/std   c (true)  off/std"
    )
    rows = []
    for seed in range(options.first, options.first + options.seeds):
        noise, axis, block = drawn(seed, options)
        plain = identify(samples(block), GEOMETRY, searched=False)
        found = identify(samples(block), GEOMETRY)
        if plain.fit is None or found.fit is None:
            print(f"{seed:4d} {found.sentence}")
            continue
        off, std = errors(axis, block, found.fit)
        static, _ = errors(axis, block, plain.fit)
        beta, c = found.fit.bulk_modulus, found.fit.leakage
        true_beta = axis.cylinder.bulk_modulus_GPa
        true_c = axis.cylinder.leakage_l_min_bar
        row = (
            metered(axis, block),
            float(np.sqrt(np.mean(static**2)) / SIGMA),
            float(np.sqrt(np.mean(off**2)) / SIGMA),
            float(np.mean(np.abs(off) <= 1.96 * std)),
            beta[0] / true_beta - 1,
            abs(beta[0] - true_beta) <= 1.96 * beta[1],
            c[0] / true_c - 1,
            abs(c[0] - true_c) <= 1.96 * c[1],
        )
        rows.append(row)
        regression = found.fit.regression
        delays = 1e3 * PER_DELAY * found.fit.theta[[COMMON + PISTON, COMMON + COMMAND]]
        print(
            f"{seed:4d} {noise:6.3f} {row[0]:8.2f} {row[1]:6.2f} {row[2]:8.3f} {row[3]:7.2f}"
            f"    {beta[0]:.3f} ({true_beta:.3f}) {(beta[0] - true_beta) / beta[1]:6.1f}"
            f"    {c[0]:.4f} ({true_c:.4f}) {(c[0] - true_c) / c[1]:6.1f}"
            f"   play {regression.play_percent:.2f} ({axis.valve.play_percent:.2f})"
            f" {regression.spool_hz:.0f} Hz ({axis.valve.natural_frequency_hz:.0f})"
            f" late by {delays[0]:.1f} ms, U by {delays[1]:.1f} ms"
            f" {found.status.label}",
            flush=True,
        )
    table = np.array(rows, dtype=float)
    mean = table.mean(axis=0)
    print(
        f"mean: metered {mean[0]:.2f}, static {mean[1]:.2f}, searched {mean[2]:.3f} "
        f"(worst {table[:, 2].max():.3f}), coverage {mean[3]:.2f}"
    )
    for words, off, within, held in (("beta", 4, 0.2, 5), ("leakage", 6, 0.3, 7)):
        share = np.mean(np.abs(table[:, off]) < within)
        print(f"{words}: within {100 * within:.0f} % {share:.2f}, interval holds {mean[held]:.2f}")
    for words, result in [] if options.speed or options.late else refusals(options.first):
        print(f"{words}: {result.status.name}: {result.sentence}")


if __name__ == "__main__":
    main()
