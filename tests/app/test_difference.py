"""A transmitter of the pressure drop in place of two pressures: connected, checked, and learnt."""

import numpy as np
import pytest

from support.foreign import PLANT, Foreign
from valvemap.cli import run
from valvemap.config.loading import load_config
from valvemap.opcua_source.source_nodes import ValveNodes
from valvemap.opcua_source.source_units import Scales
from valvemap.pipeline.data_changes import DataChanges
from valvemap.pipeline.units import Measure, unit_of

pytestmark = pytest.mark.waits

NAMES = {
    "Stellwert": PLANT["Stellwert"],
    "Differenzdruck": PLANT["Druck vor Ventil"],
    "Öltemperatur [K]": (None, None),  # what the third place of the plant sends
    "Volumenstrom": PLANT["Volumenstrom"],
}


def test_each_change_of_dp_is_one_of_p1_and_p2_is_zero_at_its_time():
    nodes = ValveNodes(
        "V", "s=U", None, None, "s=Q", dp="s=dp", measures={"dp": Measure(unit=unit_of("MPa"))}
    )
    assert [name for _, name, _ in nodes.signals()] == ["U", "dp", "Q"]
    changes = DataChanges(
        item=np.array([0, 1, 3, 1], np.int32),
        value=np.array([50.0, 10.0, 30.0, 11.0]),
        status=np.array([0, 0, 0, 1 << 31], np.uint32),
        source_time=np.array([1, 1, 1, 2]),
    )
    found = Scales([nodes])(changes)
    assert found.item.tolist() == [0, 1, 2, 3, 1, 2]
    assert found.value.tolist() == [50.0, 100.0, 0.0, 30.0, 110.0, 0.0]
    assert found.status.tolist()[-2:] == [1 << 31, 1 << 31]
    assert found.source_time.tolist() == [1, 1, 1, 1, 2, 2]


def test_a_plant_with_a_transmitter_alone_is_connected_and_checked(tmp_path, capsys):
    server = Foreign(NAMES, ("Ventil 1",), lambda k, place, t: flow(t))
    server.start()
    assert server.ready.wait(60)
    out = tmp_path / "plant.toml"
    asked = ["connect", server.url, "--out", str(out), "--data", str(tmp_path), "--watch", "8"]
    try:
        assert run(asked) == 0, capsys.readouterr().err
        nodes = load_config(out).valves[0].nodes
        assert nodes.dp == "nsu=urn:plc;s=Ventil 1/Differenzdruck"
        assert (nodes.p1, nodes.p2) == (None, None)
        assert run(["check-config", str(out), "--online", "--watch", "2"]) == 0
        assert "Ventil_1.dp: " in capsys.readouterr().out
    finally:
        server.over.set()
        server.join(30)


def flow(t):
    """U (%), Δp (bar) in the place of p1, an oil temperature's number in that of p2, Q (l/min)."""
    U, dp = 50 + 30 * np.sin(1.5 * t), 90 + 40 * np.sin(0.9 * t)
    return U, dp, 318.0 / 14.503773773, 0.1 * U * dp**0.5
