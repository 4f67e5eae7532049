"""Kernels without code run interpreted, with the same numbers, and compiled ones are unaffected."""

import os
import subprocess
import sys

# In a process of its own: there no other test has compiled a kernel before.
LIFE = """
import gc, sys, warnings
import numpy as np
from dataclasses import replace
from numba.core.registry import CPUDispatcher
from support.plant import as_changes, plant
from valvemap.app.build import build_preview
from valvemap.config.models import Config
from valvemap.config.valves import ValveConfig
from valvemap.model.kernels import interpreted
from valvemap.opcua_source.decoding import decode_data_changes
from valvemap.vocabulary.statuses import Status

warnings.simplefilter("error")

def compiled():
    everything = gc.get_objects()
    return [k for k in everything if issubclass(type(k), CPUDispatcher) and k.signatures]

def hostile(n):
    samples = plant(n)
    rng = np.random.default_rng(5)
    columns = {}
    for name in ("U", "p1", "p2", "Q", "T"):
        column = getattr(samples, name).copy()
        for value in (np.nan, 0.0, np.inf, 1e300, -1e300):
            column[rng.integers(0, n, n // 20)] = value
        columns[name] = column
    return replace(samples, **columns)

def run():
    decode_data_changes(bytes(4) + b"\\xff" * 4)
    found = {}
    for data in (plant(150), hostile(150)):
        valves = build_preview(Config(valves=[ValveConfig(name=name) for name in ("V", "W", "X")]))
        everything = as_changes(data)
        for valve in range(3):
            valves.take(replace(everything, item=everything.item + np.int32(6 * valve)))
        valves.take_samples(1, plant(20, seed=2, first=200))
        valves.maps.refresh()
        valves.predict("V", "RLS", 50.0, 50.0, 40.0)
        valves.predict_measurement("V", "RML", 50.0, 50.0, 40.0)
        valves.invert("V", 30.0, 50.0, 40.0)
        result = valves.results.one(1)
        for name, one in result.estimators.items():
            assert one.status is not Status.FAILED, name
            found[len(found), name] = one.theta, one.predicted, one.residual_rmse, one.sample_count
        assert not valves.failures.take_new()
    return found

interpreted.begin()
plain = run()
assert not compiled(), compiled()
interpreted.end()
swift = run()
assert compiled()
for key, values in plain.items():
    for one, other in zip(values, swift[key], strict=True):
        assert np.asarray(one).tobytes() == np.asarray(other).tobytes(), (key, one, other)
counts = {name: values[-1] for (_, name), values in plain.items()}
assert counts["RLS"] > 0 and counts["Auto"] == 0, counts
"""


def test_interpreted_kernels_give_the_numbers_of_compiled_ones():
    ended = subprocess.run(
        [sys.executable, "-c", LIFE],
        check=False,
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "PYTHONPATH": "tests"},
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
