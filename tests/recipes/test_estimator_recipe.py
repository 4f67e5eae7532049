"""The recipe of an estimator: a normalised LMS in three files, configured, replayed and saved."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from support.recipes import ROOT, Tree

CONFIG = "service/valvemap/config/estimators.py"
LMS = Path(__file__).with_name("normalised_lms.py")

TOML = """
[[valves]]
name = "V1"
[[valves.estimators]]
kind = "LMS"
mu = {mu}
"""

CHECKED = """
import json, sys
from pathlib import Path
from valvemap.app.build import build_identification
from valvemap.cli import run
from valvemap.config.loading import load_config
from valvemap.errors import ConfigurationError

assert run(["check-config", "valve.toml"]) == 0
identification = build_identification(load_config(Path("valve.toml")))
(estimator,) = identification.descriptions()[0].estimators
print(json.dumps([estimator.name, estimator.has_named_parameters, *estimator.parameter_names]))

for text in sys.argv[1:]:
    Path("wrong.toml").write_text(text)
    try:
        load_config(Path("wrong.toml"))
    except ConfigurationError as error:
        print(error)
"""

REPLAYED = """
from valvemap.cli import run

replay = ["replay", "run.csv", "--config", "valve.toml"]
assert run([*replay, "--json", "found.json", "--save", "model.json"]) == 0
print("and now the model")
assert run(["invert", "model.json", "--Q", "65", "--dp", "100"]) == 0
"""


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    tree = Tree(tmp_path_factory.mktemp("estimator"))
    tree.add("service/valvemap/model/normalised_lms.py", LMS.read_text())
    tree.after(
        CONFIG,
        "from valvemap.model.maximum_likelihood import MaximumLikelihood\n",
        "from valvemap.model.normalised_lms import NormalisedLms\n",
    )
    tree.before(
        CONFIG,
        "AnyEstimatorConfig = RlsConfig |",
        '''class LmsConfig(EstimatorSection):
    """Normalised least mean squares on eq. (7)."""

    kind: Literal["LMS"] = "LMS"
    name: Name = "LMS"
    mu: float = Field(0.5, gt=0.0, lt=2.0, description="step")


''',
    )
    tree.change(
        CONFIG, "AnyEstimatorConfig = RlsConfig |", "AnyEstimatorConfig = LmsConfig | RlsConfig |"
    )
    tree.after(
        CONFIG,
        "    match config:\n",
        "        case LmsConfig():\n            return NormalisedLms(mu=config.mu)\n",
    )
    (tree.folder / "valve.toml").write_text(TOML.format(mu=0.5))
    rng = np.random.default_rng(3)
    U, dp = rng.uniform(5, 95, 4000), rng.uniform(5, 190, 4000)
    Q = 0.13 * U * np.sqrt(dp) + 0.3 * rng.normal(size=4000)
    rows = zip(np.arange(4000) / 100.0, U, dp + 5.0, Q, strict=True)
    lines = [
        f"{t:.2f},{u!r},{p1!r},5.0,{q!r},40.0,V1"
        for t, u, p1, q in ((t, float(u), float(p1), float(q)) for t, u, p1, q in rows)
    ]
    (tree.folder / "run.csv").write_text("t,U,p1,p2,Q,T,valve\n" + "\n".join(lines) + "\n")
    return tree


def test_it_takes_three_files(tree):
    assert len(tree.touched) <= 3


@pytest.fixture(scope="module")
def checked(tree):
    """What its configuration gives, and the errors of wrong ones."""
    misspelt = TOML.format(mu=1.0).replace("mu =", "muu =")
    without_kind = TOML.format(mu=1.0).replace('kind = "LMS"\n', "")
    said = tree.run("-c", CHECKED, TOML.format(mu=3.0), misspelt, without_kind)
    return said.splitlines()[-4:]


def test_its_configuration_is_checked_and_errors_name_field_and_kinds(checked):
    _, of_step, of_field, of_kind = checked
    assert of_step.startswith("wrong.toml: valves[0].estimators[0].mu = 3.0: ")
    assert of_field.endswith("estimators[0].muu: there is no such field; is mu meant?")
    assert of_kind.endswith("kind is missing: allowed is one of LMS, RLS, RML, RBF, Auto")


def test_each_parameter_gets_a_node(checked):
    assert json.loads(checked[0]) == ["LMS", True, "a1", "a2", "a3", "a4", "a5"]


def test_a_recording_is_replayed_and_its_model_saved_and_loaded(tree):
    _, said = tree.run("-c", REPLAYED).split("and now the model")
    found = json.loads((tree.folder / "found.json").read_text())["V1"]["LMS"]
    assert found["parameters"]["a4"] == pytest.approx(0.13, rel=0.15)
    assert found["one_step"]["rmse"] < 8.0
    saved = json.loads((tree.folder / "model.json").read_text())
    assert saved["parameters"]["a4"] == found["parameters"]["a4"]
    assert re.search(r"\b(49|50|51)\.\d", said), said


def test_it_passes_every_shared_check(tree):
    folder = tree.folder / "tests"
    folder.mkdir()
    for name in ("conftest.py", "test_every_estimator.py"):
        shutil.copy(ROOT / "tests/model" / name, folder)
    tree.change(
        "tests/conftest.py",
        "ESTIMATORS = {\n",
        "from valvemap.model.normalised_lms import NormalisedLms\n"
        'ESTIMATORS = {\n    "LMS": NormalisedLms(),\n',
    )
    (folder / "pytest.ini").write_text("[pytest]\nmarkers = soak\n")
    said = tree.run(
        "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not soak", "-k", "LMS", folder
    )
    assert " passed" in said
