"""`[valves.commission]`: what a run could not keep, or must not do, is refused with its remedy."""

import pytest

from valvemap.config.loading import load_config
from valvemap.errors import ConfigurationError

NODES = "[valves.nodes]\nU = 's=U'\nQ = 's=Q'\nrequired_U = 's=C'\nheartbeat = 's=B'\n"
PRESSURES = "p1 = 's=p1'\np2 = 's=p2'\n"
DRIVEN = f"[[valves]]\n{NODES}{PRESSURES}[valves.commission]\n"
NARROW = f"[[valves]]\nU_range_percent = [10, 90]\n{NODES}{PRESSURES}[valves.commission]\n"
OF_LOAD = "load_range_bar = [5, 190]\nsafe_load_bar = 150\n"
LOADED = f"[[valves]]\n{NODES}{PRESSURES}load = 's=L'\n[valves.commission]\n{OF_LOAD}"
ONE_DROP = f"[[valves]]\n{NODES}dp = 's=dp'\n{{load}}[valves.commission]\n"


@pytest.fixture
def loaded(tmp_path):
    def load(text):
        file = tmp_path / "v.toml"
        file.write_text(text, encoding="utf-8")
        return load_config(file).valves[0].commission

    return load


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            NARROW + "range_percent = [0, 80]\n",
            "commission.range_percent = [0.0, 80.0]: must be within U_range_percent = [10.0, 90.0]",
        ),
        (DRIVEN + "range_percent = [-50, 80]\n", "must be within U_range_percent = [0.0, 100.0]"),
        (
            DRIVEN + "range_percent = [40, 42]\n",
            "commission.range_percent = [40.0, 42.0]: must be wider than follow_percent = 3",
        ),
        (
            DRIVEN + "slew_percent_per_s = 8\n",
            "commission.slew_percent_per_s = 8: U needs 25 s from end to end and back",
        ),
        (
            DRIVEN + "slew_percent_per_s = 25\nlast_period_s = 8\n",
            "commission.slew_percent_per_s = 25: U needs 8 s from end to end and back",
        ),
        (
            LOADED + "load_slew_bar_per_s = 9\n",
            "commission.load_slew_bar_per_s = 9: the load needs 41.1 s from end to end and back",
        ),
        (
            LOADED + "p2_range_bar = [5, 140]\n",
            "commission.safe_load_bar = 150: must be within p2_range_bar = [5.0, 140.0]",
        ),
        (
            DRIVEN + "p2_range_bar = [150, 220]\np_most_bar = 100\n",
            "p_most_bar = 100: must exceed 150 of p2_range_bar",
        ),
        (
            ONE_DROP.format(load="load = 's=L'\n") + OF_LOAD,
            "nodes.load: nodes.p1 and nodes.p2 are needed; dp alone does not tell the load",
        ),
        (
            ONE_DROP.format(load="") + "p1_range_bar = [150, 220]\n",
            "commission.p1_range_bar: nodes.p1 and nodes.p2 are needed; dp alone tells no pressure",
        ),
        (ONE_DROP.format(load="") + "p_most_bar = 220\n", "commission.p_most_bar: nodes.p1 and"),
    ],
)
def test_what_a_run_cannot_keep_is_refused(loaded, text, said):
    with pytest.raises(ConfigurationError) as refused:
        loaded(text)
    assert said in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


def test_slower_triangles_are_permitted_while_one_of_them_fits(loaded):
    given = loaded(DRIVEN + "slew_percent_per_s = 10\n")
    assert given.plan().paced_period(given.limits((0.0, 100.0))) == pytest.approx(20.0)
    assert loaded(DRIVEN + "sweep_s = 2\n").plan().sweep_s == 2.0  # half of one
    given = loaded(LOADED)
    assert given.plan().paced_period(given.limits((0.0, 100.0))) == 4.0


def test_a_valve_that_is_not_driven_may_have_any_defaults(loaded):
    assert loaded("[[valves]]\nU_range_percent = [40, 42]\n").range_percent is None
