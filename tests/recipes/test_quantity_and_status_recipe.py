"""The recipes of a quantity and of a status: three files each."""

import json

import pytest

from support.recipes import Tree
from valvemap.vocabulary.statuses import Status

QUANTITIES = "service/valvemap/vocabulary/quantities.py"
RESULTS, LANES = "service/valvemap/pipeline/results.py", "service/valvemap/pipeline/lane_results.py"
STATUSES = "service/valvemap/vocabulary/statuses.py"
CODES = "service/valvemap/opcua_results/result_codes.py"

QUANTITY_USED = """
import json
import numpy as np
from valvemap.app.build import build_identification
from valvemap.config.estimators import RlsConfig
from valvemap.config.models import Config
from valvemap.config.valves import ValveConfig
from valvemap.model.samples import Samples
from valvemap.opcua_results.information_model import estimator_variables
from valvemap.opcua_results.result_frames import frame_names
from valvemap.vocabulary.quantities import ESTIMATOR_QUANTITIES

found = {}
identification = build_identification(
    Config(valves=(ValveConfig(name="V1", estimators=(RlsConfig(),)),))
)
rng = np.random.default_rng(1)
U, dp = rng.uniform(5, 95, 200), rng.uniform(5, 190, 200)
samples = Samples.of(np.arange(200) * 10**7 + 10**18, U, dp, 0 * dp, 0.1 * U * np.sqrt(dp))
identification.take_samples(0, samples)
(valve,) = identification.descriptions()
nodes = {n.id: n for n in estimator_variables(valve, valve.estimators[0])}
found["nodes"] = [id_ for id_ in nodes if id_.endswith("Doubled")]
found["frame"] = [name for name in frame_names(valve) if name.endswith("Doubled")]
result = identification.results.one(0).estimators["RLS"]
found["value"] = bool(getattr(result, "doubled", None) == 2.0 * result.residual)
print(json.dumps(found))
"""
STATUS_USED = """
from valvemap.model.kernels import interpreted
interpreted.begin()  # else those that name statuses are compiled anew, to compute nothing

from valvemap.app.build import build_identification
from valvemap.config.estimators import RlsConfig
from valvemap.config.models import Config
from valvemap.config.valves import ValveConfig
from valvemap.opcua_results.information_model import estimator_variables

config = Config(valves=(ValveConfig(name="V1", estimators=(RlsConfig(),)),))
(valve,) = build_identification(config).descriptions()
nodes = {n.id: n for n in estimator_variables(valve, valve.estimators[0])}
print(nodes["V1.RLS.Status"].enum_strings[-1])
"""


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    return Tree(tmp_path_factory.mktemp("quantity"))


@pytest.fixture(scope="module")
def quantity(tree):
    tree.touched.clear()
    tree.after(
        QUANTITIES,
        "ESTIMATOR_QUANTITIES: Final = (\n",
        '    Quantity("Doubled", "doubled", "Twice the residual.", unit="l/min", in_frame=True),\n',
    )
    tree.after(RESULTS, "    residual_rmse: float\n", "    doubled: float\n")
    tree.after(RESULTS, "    residual_rmse: Floats\n", "    doubled: Floats\n")
    tree.before(
        LANES,
        "        residual_rmse=recent_rmse(",
        "        doubled=2.0 * notes.residual[chosen],\n",
    )
    tree.before(LANES, "        residual_rmse=nothing,", "        doubled=nothing,\n")
    return len(tree.touched), json.loads(tree.run("-c", QUANTITY_USED).splitlines()[-1])


@pytest.fixture(scope="module")
def status(tree, quantity):  # after it: kernels that name statuses would be compiled again
    assert quantity
    tree.touched.clear()
    tree.before(
        STATUSES,
        "\n\nclass Adaptation(Described):",
        f'    STALLED = {len(Status)}, "stalled", "The estimator waits for a part of the plant."\n',
    )
    tree.after(
        CODES,
        "    Status.FAILED: _Codes.BadInternalError,\n",
        "    Status.STALLED: _Codes.BadSensorFailure,\n",
    )
    return len(tree.touched), tree.run("-c", STATUS_USED).splitlines()[-1]


def test_a_quantity_takes_three_files_and_has_a_node_and_a_place_in_the_frame(quantity):
    files, found = quantity
    assert files == 3
    assert found == {"nodes": ["V1.RLS.Doubled"], "frame": ["RLS.Doubled"], "value": True}


def test_a_status_takes_two_files_and_has_a_name(status):
    assert status == (2, "STALLED")
