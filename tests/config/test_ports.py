"""Valves with ports: what is read of a file, and what is refused."""

import numpy as np
import pytest

from support import ports
from valvemap.app.build import build_plans
from valvemap.app.replay import replay
from valvemap.config.loading import load_config
from valvemap.errors import ConfigurationError


def load(tmp_path, text):
    file = tmp_path / "service.toml"
    file.write_text(text, encoding="utf-8")
    return load_config(file)


def complaint(tmp_path, text):
    with pytest.raises(ConfigurationError) as caught:
        load(tmp_path, text)
    return str(caught.value)


def without(*names):
    lines = ports.toml().splitlines(keepends=True)
    return "".join(line for line in lines if line.split(" =")[0] not in names)


def test_a_valve_with_four_edges_is_two_lines_and_four_edges(tmp_path):
    valves = load(tmp_path, ports.toml()).valves
    found = {v.name: (v.nodes.p1[-2:], v.nodes.p2[-2:], v.nodes.Q[-2:]) for v in valves}
    assert found == {
        "V.LineA": ("pA", "pB", "QA"),
        "V.LineB": ("pB", "pA", "QB"),
        "V.PA": ("pP", "pA", "QA"),
        "V.AT": ("pA", "pT", "QA"),
        "V.PB": ("pP", "pB", "QB"),
        "V.BT": ("pB", "pT", "QB"),
    }
    assert {v.U_range_percent for v in valves[2:]} == {(0.0, 100.0)}


def test_the_flow_of_a_line_has_either_sign(tmp_path):
    valves = load(tmp_path, ports.toml(head="Q_range_l_min = [0, 120]")).valves
    found = {valve.name: valve.Q_range_l_min for valve in valves}
    assert found["V.LineA"] == found["V.LineB"] == (-120.0, 120.0)
    assert found["V.PA"] == (0.0, 120.0)


def test_a_line_without_a_meter_has_no_edges(tmp_path):
    names = [v.name for v in load(tmp_path, without("QB")).valves]
    assert names == ["V.LineA", "V.PA", "V.AT"]


def test_chosen_edges_alone_are_learnt(tmp_path):
    text = ports.toml(more='edges = ["PA", "BT"]')
    assert [v.name for v in load(tmp_path, text).valves][2:] == ["V.PA", "V.BT"]
    text = without("pT").replace("[valves.ports]", '[valves.ports]\nedges = ["PA", "BT"]')
    assert "edges: BT cannot be learnt, pT is missing" in complaint(tmp_path, text)


def test_two_ports_are_one_valve_that_keeps_its_name(tmp_path):
    text = without("pT", "pB", "QB").replace('kind = "RLS"', 'kind = "Auto"')
    (valve,) = load(tmp_path, text).valves
    assert (valve.name, valve.U_range_percent) == ("V", (-100.0, 100.0))


def test_a_transmitter_of_the_difference_replaces_two_pressures(tmp_path):
    text = without("pT").replace("[valves.ports]", '[valves.ports]\ndpAT = "s=X"')
    by_name = {v.name: v for v in load(tmp_path, text).valves}
    assert by_name["V.AT"].nodes.dp == "s=X"
    assert "V.BT" not in by_name


def test_units_are_given_by_port(tmp_path):
    text = ports.toml(more='signals.pP = { unit = "psi", accuracy = 14.5 }')
    plans = {plan.name: plan for plan in build_plans(load(tmp_path, text))}
    assert plans["V.PA"].accuracy.p1 == pytest.approx(1.0, rel=1e-3)
    assert plans["V.AT"].accuracy.p1 == 0.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (without("U"), "valves[0].ports.U: this field is required"),
        (without("QA", "QB"), "valves[0].ports: a flow is missing, QA or QB"),
        (without("pA"), "line A has a flow, QA, and no pressure drop: pA with pP or pT is needed"),
        (ports.toml(more='pQ = "s=X"'), "valves[0].ports.pQ: there is no such field"),
        (ports.toml().replace("s=V.pA", "s=V.pB"), "pA and pB are the same node"),
        (ports.toml(head="U_range_percent = [0, 100]"), "works both ways"),
        (
            ports.toml(more='signals.QA = { unit = "bar" }'),
            "the unit of QA, 'bar', is one of pressure",
        ),
        (
            ports.toml(head='signals.U = { unit = "%" }'),
            "its units and columns are in ports.signals",
        ),
        (
            ports.toml(head="nodes = { U = 's=U', dp = 's=d', Q = 's=Q' }"),
            "leave out nodes",
        ),
        (ports.toml(more="closed_percent = 80"), "valves[0].ports.closed_percent = 80"),
        (
            ports.toml().replace('kind = "RLS"', 'kind = "RLS"\nname = "PA"'),
            "estimator name 'PA' is taken",
        ),
    ],
)
def test_errors_name_field_and_remedy(tmp_path, text, said):
    assert said in complaint(tmp_path, text)


def test_a_recording_by_port_is_replayed(tmp_path):
    recorded = ports.recording(seconds=40.0)
    report = replay(recorded, load(tmp_path, ports.toml()), verify=ports.recording(10.0, seed=2))
    assert list(report)[:2] == ["V.LineA", "V.LineB"]
    assert report["V.LineA"]["Leak"].parameters["c"] == pytest.approx(ports.LEAKAGE, rel=0.05)
    for edge in ("PA", "AT", "PB", "BT"):
        assert report[f"V.{edge}"]["RLS"].verify.r2 > 0.95
    alone = replay(recorded, load(tmp_path, ports.toml()), only={"V.PA"})
    assert list(alone) == ["V.LineA", "V.PA"]
    assert alone["V.PA"]["RLS"].parameters == report["V.PA"]["RLS"].parameters


def test_what_record_writes_of_parts_is_replayed_as_its_twin_by_port(tmp_path):
    config, recorded = load(tmp_path, ports.toml()), ports.recording(seconds=20.0)
    plain = replay(recorded, config)
    rows = {name: [] for name in ("t", "U", "p1", "p2", "Q", "T", "valve")}
    for valve in config.valves:
        for name in ("U", "p1", "p2", "Q", "T"):
            node = valve.nodes.of(name).rpartition(".")[2]
            rows[name].append(recorded[node])
        rows["t"].append(recorded["t"])
        rows["valve"].append(np.full(len(recorded["t"]), valve.name))
    found = replay({name: np.concatenate(parts) for name, parts in rows.items()}, config)
    for name in plain:
        for estimator, own in plain[name].items():
            assert found[name][estimator].parameters == own.parameters
