from pathlib import Path

import pytest

from valvemap_rig.circuit import reachable, true_flow
from valvemap_rig.scenario import BUILTIN, Scenario, ScenarioError, ValveBench, load_scenario
from valvemap_rig.valvistor import Valvistor
from valvemap_rig.verification import verification_points

EXAMPLES = Path(__file__).parents[2] / "config" / "scenarios"


@pytest.mark.parametrize(
    "name", ["structured", "scattered", "verification", "cycle", "external", "feedforward"]
)
def test_the_example_file_is_the_built_in_scenario(name):
    assert load_scenario(EXAMPLES / f"{name}.toml") == BUILTIN[name]


def test_every_example_file_is_a_scenario():
    for path in EXAMPLES.glob("*.toml"):
        assert load_scenario(path).name == path.stem


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("sample_rate_hz = 5000", r"sample_rate_hz: .* less than or equal to 1000, not 5000"),
        ("sample_rate = 5", r"unknown field 'sample_rate'; allowed are name, description, seed"),
        ("seed = 'x'", r"seed: .*integer.*, not 'x'"),
        ("[excitation]\nkind = 'dance'", r"excitation: .*'dance'.*'structured'"),
        ("[excitation]\nkind = 'scattered'\nhold = 1", r"excitation: unknown field 'hold'"),
        ("[sensors]\nQ = { noise = -1 }", r"sensors\.Q\.noise: .*greater than or equal to 0"),
        ("[[valves]]\nname = 'a.b'", r"valves\.0\.name: .*pattern"),
        ("[[valves]]\n[[valves]]", r"name 'Valvistor' is given twice"),
        ("[[valves]]\n[valves.valve]\nphi = nan", r"valves\.0\.valve\.phi: .*finite"),
        ("[[faults]]\nkind = 'rust'", r"faults\.0\.kind: .*'wear'"),
        ("[[faults]]\nkind = 'damage'\nsize = 500", r"size of damage must be within -90 … 100"),
        ("[[faults]]\nkind = 'damage'\nvalve = 'X'", r"valve 'X' is not there; .* Valvistor"),
        ("seed = ", "not TOML"),
    ],
)
def test_an_error_names_file_field_value_and_what_is_allowed_in_one_line(tmp_path, text, sentence):
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")

    with pytest.raises(ScenarioError, match=sentence) as caught:
        load_scenario(path)

    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_told_with_the_names_that_are_built_in():
    with pytest.raises(ScenarioError, match=r"nowhere\.toml: no such file, nor built in: demo"):
        load_scenario("nowhere.toml")


def test_a_directory_is_no_scenario(tmp_path):
    with pytest.raises(ScenarioError, match="cannot be read"):
        load_scenario(tmp_path)


def test_a_scenario_does_not_change():
    with pytest.raises(ValueError, match="frozen"):
        Scenario().seed = 2  # type: ignore[misc]


def test_the_scenarios_of_the_contract_are_built_in():
    wanted = {"structured", "scattered", "verification", "cycle", "external", "demo"}
    assert wanted <= set(BUILTIN)
    for name, scenario in BUILTIN.items():
        assert scenario.name == name


def test_verification_points_can_be_reached_and_hold_the_truth():
    points = verification_points(BUILTIN["demo"])
    bench = BUILTIN["demo"].valves[0]
    assert reachable(bench, points.U, points.dp, points.T).all()
    assert (true_flow(bench, points.U, points.dp, points.T) == points.Q).all()
    assert points.Q.max() < 202


def test_each_valve_has_a_truth_of_its_own():
    second = ValveBench(name="Second", valve=Valvistor(K_MP=3.0))
    scenario = Scenario(valves=(ValveBench(), second))
    assert verification_points(scenario, "Second").Q.mean() < (
        0.8 * verification_points(scenario, "Valvistor").Q.mean()
    )


def test_there_is_no_truth_of_a_valve_that_is_not_there():
    with pytest.raises(ScenarioError, match="X: no such valve; allowed are Valvistor"):
        verification_points(Scenario(), "X")
