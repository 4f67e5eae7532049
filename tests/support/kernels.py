"""Compiles once what two processes of tests would compile twice: ``python -m support.kernels``.

`valvemap warm-up` compiles what a service of one valve needs; tests also use axes, ports, shared
meters, every estimator and the rig. Nothing is done where all that was done before.
"""

import sys
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.shared_meter import config_of
from model.conftest import ESTIMATORS
from support import ports
from valvemap.app.warm_up import warm_up
from valvemap.cli import run
from valvemap.config.loading import load_config
from valvemap.config.models import Config
from valvemap.model.armax import recursive_maximum_likelihood
from valvemap.model.axis import AxisGeometry, AxisSamples
from valvemap.model.axis_force import ForceReference
from valvemap.model.axis_search import identify
from valvemap.model.axis_travel import placed
from valvemap.model.capabilities import Invertible
from valvemap.model.forgetting import Adaptive
from valvemap.model.inverse_map import invert
from valvemap.model.kernels import warmed_up
from valvemap.model.least_squares_of_arrays import recursive_least_squares
from valvemap.model.model_structures import Polynomial
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap_rig.directional import DirectionalValve
from valvemap_rig.machine import Machine
from valvemap_rig.scenario import BUILTIN, Scenario
from valvemap_rig.simulation import Commands, advance, initial

PROCESSES = 2


def every_estimator():
    k = np.arange(200.0)
    U, dp = (37.0 * k) % 100.0, (1.0 + 61.0 * k) % 200.0
    samples = Samples.of(k, U, dp + 5.0, 0.0 * k + 5.0, 0.1 * U * np.sqrt(dp), 0.0 * k + 40.0)
    of_nine_terms = RecursiveLeastSquares(Polynomial.of_order(2), Adaptive())
    for estimator in (*ESTIMATORS.values(), of_nine_terms):
        state, _ = estimator.update(estimator.initial_state(), samples)
        estimator.predict(state, samples.U, samples.dp, samples.T)
        estimator.parameters(state)
        estimator.adaptation(state)
        if isinstance(estimator, Invertible):
            invert(estimator, state, samples.Q, samples.dp, samples.T)
    recursive_least_squares(np.stack([np.ones(200), k], axis=1), k)
    recursive_maximum_likelihood(k, U, na=1, nb=1, nd=1)


def axis():
    machine = Machine(
        name="Axis",
        measures="position",
        valve=DirectionalValve(leakage_l_min_bar=0.0, play_percent=2.0),
    )
    rig = Scenario(valves=(), machines=(machine,), sample_rate_hz=100.0)
    block = advance(rig, initial(rig, 0), 7_000, Commands())[1].machines["Axis"]
    samples, geometry = AxisSamples.of(block.t, **block.shown), AxisGeometry(63, 45, 800, 1.2, 1.2)
    identify(samples, geometry)
    v = np.gradient(block.shown["x"], 0.01)
    placed(AxisSamples.of(block.t, v=v), geometry.stroke_mm)
    ForceReference.of(geometry, 0.01, samples, v)


def rig():
    advance(BUILTIN["demo"], initial(BUILTIN["demo"], 0), 100, Commands())


def rig_of_commands():
    """The same loops: under a command they have another cache."""
    with TemporaryDirectory() as folder:
        assert run(["rig", "--offline", "--duration", "1", "--record", f"{folder}/r.csv"]) == 0


def valves_with_ports():
    with TemporaryDirectory() as folder:
        file = Path(folder, "service.toml")
        file.write_text(ports.toml("RLS RML RBF Auto"), encoding="utf-8")
        warm_up(load_config(file))


def shared_meter():
    warm_up(config_of(shared=True))


PARTS = (every_estimator, axis, valves_with_ports, shared_meter, rig, rig_of_commands)


def main():
    if is_done():
        return
    sys.stderr.write("compiling kernels: some minutes, once\n")
    warm_up(Config())
    compile_parts()
    note().write_text(warmed_up._stamp_of_all(), encoding="utf-8")


def is_done():
    return warmed_up.was_warmed_up() and warmed_up._read(note()) == warmed_up._stamp_of_all()


def note():
    """Beside that of a warm-up, which an installation also leaves: it has compiled no part."""
    of_warm_up = warmed_up._note()
    return of_warm_up.with_name(f"tests-{of_warm_up.name}")


def compile_parts():
    with get_context("spawn").Pool(PROCESSES, maxtasksperchild=1) as pool:
        for part in [pool.apply_async(part) for part in PARTS]:
            part.get()


if __name__ == "__main__":
    main()
