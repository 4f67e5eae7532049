"""Nothing is compiled once the service runs: a compiler holds the loop for seconds."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context

from valvemap.app import warm_up, warm_up_parts
from valvemap.config.models import Config

# In a process of its own: there no other test has used a kernel before.
LIFE = """
import gc, sys
from dataclasses import replace
import numpy as np
from numba.core.registry import CPUDispatcher
from valvemap.app.build import build_identification
from valvemap.app.warm_up import warm_up
from valvemap.config.models import Config
from valvemap.pipeline.operator_ports import Command
from support.plant import as_changes, plant

def used():
    everything = gc.get_objects()
    return {
        f"{kernel.__module__}.{kernel.__name__}{signature}"
        for kernel in everything
        if issubclass(type(kernel), CPUDispatcher) and kernel.__module__.startswith("valvemap.")
        for signature in kernel.signatures
    }

config = Config()
warm_up(config)
before = used()
identification = build_identification(config)
for first in range(0, 9_000, 50):
    changes = as_changes(plant(50, seed=first, first=first))
    identification.take(changes)
    identification.arrivals.waits()
    if first % 1_000 == 0:
        identification.maps.refresh()
        identification.results.one(0)
identification.wait_no_longer(np.zeros(1, np.int64))
identification.begin_source_anew(np.zeros(1, np.int64), 1)
identification.invert("Valvistor", 30.0, 50.0, 40.0)
for estimator in identification.plans[0].estimators:
    identification.predict("Valvistor", estimator, 50.0, 50.0, 40.0)
    identification.predict_measurement("Valvistor", estimator, 50.0, 50.0, 40.0)
    identification.do(Command.of("reset", "Valvistor", estimator))
identification.restore(identification.states.checkpoints())
identification.take(as_changes(plant(2_000, first=20_000)))

skewed = build_identification(config)  # signals that carry no common time
for first in range(0, 1_000, 50):
    changes = as_changes(plant(50, seed=first, first=first))
    time = changes.source_time + changes.item % 6 * 500_000
    skewed.take(replace(changes, source_time=time))
assert skewed.results.one(0).estimators["RLS"].sample_count > 800
skewed.wait_no_longer(np.zeros(1, np.int64))
late = sorted(used() - before)
print(*late, sep="\\n")
sys.exit(bool(late))
"""


def test_a_long_life_compiles_nothing_that_the_warm_up_did_not():
    env = {**os.environ, "PYTHONPATH": "tests"}
    ended = subprocess.run(
        [sys.executable, "-c", LIFE],
        check=False,
        capture_output=True,
        text=True,
        timeout=300,
        env=env,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr


def test_two_valves_of_those_behind_one_meter_are_warmed_up():
    valve = Config().valves[0]
    nodes = [valve.nodes.model_copy(update={"U": f"ns=1;s=U{k}"}) for k in range(3)]
    valves = tuple(
        valve.model_copy(update={"name": f"V{k}", "nodes": one}) for k, one in enumerate(nodes)
    )
    config = warm_up._one_of_each_kind(Config(valves=valves))
    assert [one.name for one in config.valves] == ["V0", "V1", "V2"][: len(config.valves)]
    assert len(config.valves) >= 2
    assert warm_up_parts._share_a_meter in warm_up_parts.parts_of(config)


def test_two_that_compile_take_each_part_once_and_count_it(monkeypatch):
    ran = []
    parts = [partial(ran.append, number) for number in range(20)]
    monkeypatch.setattr(warm_up, "parts_of", lambda _: parts)
    taken, done = (get_context("spawn").Value("i", 0) for _ in range(2))
    with ThreadPoolExecutor(2) as pool:
        take = partial(warm_up._take_parts, Config(), taken, done)
        list(pool.map(lambda _: take(lambda: False), range(2)))
    assert sorted(ran) == list(range(20))
    assert done.value == 20


def test_whoever_presses_ctrl_c_waits_for_no_further_part(monkeypatch):
    ran = []
    parts = [partial(ran.append, number) for number in range(20)]
    monkeypatch.setattr(warm_up, "parts_of", lambda _: parts)
    taken, done = (get_context("spawn").Value("i", 0) for _ in range(2))
    warm_up._take_parts(Config(), taken, done, lambda: len(ran) == 3)
    assert ran == [0, 1, 2]
    warm_up._take_parts(Config(), taken, done, lambda: False)  # the other process
    assert ran == [0, 1, 2]
