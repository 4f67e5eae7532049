"""The recipe of a signal: an optional third pressure in four files, which a structure uses."""

import json

import pytest

from support.recipes import Tree

SIGNALS = "service/valvemap/vocabulary/signals.py"
STRUCTURE = '''"""Eq. (7) with the effect of a pressure in the return line."""

from dataclasses import dataclass

import numpy as np

from valvemap.model.model_structures import FiveTerms
from valvemap.model.samples import Floats, Samples


@dataclass(frozen=True)
class WithReturn(FiveTerms):
    """Eq. (7) + a6·p3; a p3 that is not known counts as 0 bar."""

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Those of eq. (7), and a6."""
        return (*super().parameter_names, "a6")

    def regressors(self, U: Floats, dp: Floats, T: Floats) -> Floats:
        """Return rows (N, 6) at p3 = 0."""
        return np.column_stack((super().regressors(U, dp, T), np.zeros(len(U))))

    def regressors_of(self, samples: Samples) -> Floats:
        """Return rows (N, 6) of samples."""
        rows = self.regressors(samples.U, samples.dp, samples.T)
        rows[:, -1] = np.nan_to_num(samples.p3)
        return rows
'''

USED = """
import json
from pathlib import Path
import numpy as np
from valvemap.app.build import build_alignment, build_identification
from valvemap.config.loading import load_config
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.model.with_return import WithReturn
from valvemap.opcua_results.information_model import signal_variables
from valvemap.opcua_source.source_nodes import ValveNodes
from valvemap.page.greeting import _signals
from valvemap.pipeline.data_changes import DataChanges
from valvemap.storage.recording_writer import RecordingWriter
from valvemap.storage.recordings import read_recording
from valvemap.vocabulary.signals import PER_VALVE, PUBLISHED, Signal

found = {}
config = load_config(Path("valves.toml"))
identification = build_identification(config)
N = 40
rng = np.random.default_rng(1)
values = {
    "U": rng.uniform(10, 90, N), "p1": rng.uniform(100, 200, N), "p2": rng.uniform(1, 20, N),
    "p3": rng.uniform(0, 5, N), "T": rng.uniform(38, 42, N),
}
values["Q"] = 0.1 * values["U"] * np.sqrt(values["p1"] - values["p2"]) + 2.0 * values["p3"]
parts = []
for number, valve in enumerate(config.valves):
    for k in range(N):
        for signal in Signal:
            if valve.nodes.of(signal.label) and signal is not Signal.SEQUENCE:
                parts.append((number * PER_VALVE + signal, values[signal.label][k], k * 10**7))
item, value, time = zip(*parts)
changes = DataChanges(
    np.array(item, np.int32), np.array(value), np.zeros(len(item), np.uint32),
    np.array(time, np.int64) + 10**18,
)
arrived = identification.take(changes)
found["samples"] = [len(arrived[0]), len(arrived[1])]
found["quality"] = [arrived[v].quality.max().item() for v in (0, 1)]
found["p3"] = [float(arrived[0].p3[7]) == values["p3"][7], bool(np.isnan(arrived[1].p3).all())]
newest = [r.signals.values[0, PUBLISHED.index("p3")] for r in identification.results.of([0, 1])]
found["published"] = [float(newest[0]) == values["p3"][-1], bool(np.isnan(newest[1]))]
nodes = signal_variables(identification.descriptions()[0])
found["node"] = [[n.id, n.unit.name] for n in nodes if n.id.endswith("p3")]
found["page"] = dict(_signals())["p3"]
with RecordingWriter(Path("with.csv")) as recording:
    recording.append("V1", arrived[0])
(_, read), = [part[:2] for part in read_recording(Path("with.csv"))]
found["recorded"] = bool((read.p3 == values["p3"]).all())
rls = RecursiveLeastSquares(WithReturn())
state, _ = rls.update(rls.initial_state(), arrived[0])
found["a6"] = float(rls.parameters(state)[0][-1])
without = Samples.of(arrived[0].t, *(values[n] for n in ("U", "p1", "p2", "Q", "T")))
_, trace = rls.update(state, without)
found["without"] = sorted(set(trace.status.tolist()))
nodes = ValveNodes("V1", **{s.label: f"ns=2;s={s.label}" for s in Signal})
found["read"] = [name for _, name, _ in nodes.signals()]
print(json.dumps(found, default=bool))
"""

NODES = 'U = "ns=2;s=U"\np1 = "ns=2;s=a"\np2 = "ns=2;s=b"\nQ = "ns=2;s=Q"\nT = "ns=2;s=T"\n'
TOML = f"""
[[valves]]
name = "V1"
[[valves.estimators]]
kind = "RLS"
[valves.nodes]
{NODES}
p3 = "ns=2;s=c"
[valves.gate.p3]
high = 50.0
[[valves]]
name = "V2"
[[valves.estimators]]
kind = "RLS"
[valves.nodes]
{NODES}
"""


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    tree = Tree(tmp_path_factory.mktemp("signal"))
    tree.change(
        SIGNALS,
        '        *(5, "sequence",',
        '        *(6, "sequence",',
    )
    tree.before(
        SIGNALS,
        "    SEQUENCE = (\n",
        '    P3 = 5, "p3", "bar", Need.OPTIONAL, (-10.0, 10_000.0), "return pressure"\n',
    )
    tree.after("service/valvemap/model/samples.py", "    T: Floats\n", "    p3: Floats\n")
    tree.after(
        "service/valvemap/opcua_source/source_nodes.py",
        "    T: str | None = None\n",
        "    p3: str | None = None\n",
    )
    tree.add("service/valvemap/model/with_return.py", STRUCTURE)
    (tree.folder / "valves.toml").write_text(TOML)
    return tree


def test_it_takes_six_files_or_fewer(tree):
    assert len(tree.touched) <= 6


RECORDED = """
from valvemap.storage.recordings import read_recording

for headings in ("t,U,p1,p2,Q,T,p3", "t,U [%],p1 [bar],p2 [bar],Q [l/min],T [°C],p3 [psi]"):
    with open("by_hand.csv", "w", encoding="utf-8") as file:
        file.write(headings + "\\n" + "0,50,150,10,40,40,2\\n" * 3)
    (part,) = read_recording("by_hand.csv").parts
    print(*part.numbers)
"""


def test_its_column_is_found_in_a_recording(tree):
    every = "U p1 p2 Q T p3"
    assert tree.run("-c", RECORDED).splitlines() == [every, every]


@pytest.mark.soak  # it compiles the loops for another number of signals, 20 s
def test_it_is_configured_aligned_gated_published_recorded_and_used(tree):
    found = json.loads(tree.run("-c", USED).splitlines()[-1])
    assert found.pop("a6") == pytest.approx(2.0, abs=0.01)
    assert found == {
        "samples": [40, 40],
        "quality": [0, 0],  # without p3 they are good
        "p3": [True, True],
        "published": [True, True],
        "node": [["V1.Signals.p3", "BAR"]],
        "page": ["p3", "bar"],
        "recorded": True,
        "without": [0],  # samples without p3 are OK to a structure that uses it
        "read": ["U", "p1", "p2", "Q", "T", "p3", "sequence"],
    }
