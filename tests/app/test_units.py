"""A recording in a plant's own units and names teaches the same map as its twin in ours."""

import numpy as np
import pytest

from valvemap.app.replay import replay
from valvemap.cli import run
from valvemap.config.loading import load_config
from valvemap.errors import ConfigurationError, RecordingError

N = 4_000
PSI, GALLON = 0.45359237 * 9.80665 / 0.0254**2 / 1e5, 3.785411784

PLANT = """
[recording]
time = "Zeit"

[[valves]]
name = "V7"
[valves.signals]
U = { column = "FCV-101.cmd", unit = "mA", raw = [4, 20], range = [0, 100] }
p1 = { column = "PT-1 supply", unit = "psi" }
p2 = { column = "PT-2 return", unit = "psi" }
Q = { column = "FT-9", unit = "gpm" }
T = { column = "TT-3", unit = "°F" }
"""


@pytest.fixture(scope="module")
def samples():
    rng = np.random.default_rng(16)
    U, dp = rng.uniform(0.0, 100.0, N), rng.uniform(2.0, 190.0, N)
    T = 40.0 + 10.0 * np.sin(np.arange(N) / 700)
    Q = 0.12 * np.clip(U - 5.0, 0.0, None) * np.sqrt(dp) + rng.normal(0.0, 0.4, N)
    return np.arange(N) * 0.1, U, dp + 7.0, np.full(N, 7.0), Q, T


def columns(text, table, separator=","):
    lines = [separator.join(repr(float(x)) for x in row) for row in np.column_stack(table)]
    return "\n".join([text, *lines]) + "\n"


@pytest.fixture(scope="module")
def twins(samples, tmp_path_factory):
    folder = tmp_path_factory.mktemp("twins")
    t, U, p1, p2, Q, T = samples
    ours, theirs, config = folder / "bar.csv", folder / "psi.csv", folder / "plant.toml"
    ours.write_text(columns("t,U,p1,p2,Q,T", samples))
    foreign = (T * 1.8 + 32.0, Q / GALLON, p2 / PSI, p1 / PSI, 4.0 + 0.16 * U, t)
    heading = "TT-3;FT-9;PT-2 return;PT-1 supply;FCV-101.cmd;Zeit"
    theirs.write_text(
        columns(heading, foreign, ";").replace(".", ",").replace("101,cmd", "101.cmd")
    )
    config.write_text(PLANT, encoding="utf-8")
    return replay([ours])["Valvistor"], replay([theirs], load_config(config))["V7"]


@pytest.mark.parametrize(
    ("name", "bound"), [("RLS", 1e-9), ("RML", 1e-9), ("RBF", 1e-9), ("Auto", 1e-6)]
)
def test_psi_gpm_ma_and_fahrenheit_teach_what_their_twin_in_bar_teaches(twins, name, bound):
    U, dp = (x.ravel() for x in np.meshgrid(np.linspace(0, 100, 20), np.linspace(1, 190, 20)))
    T = np.full_like(U, 45.0)
    ours, theirs = (
        report[name].lane.estimator.predict(report[name].lane.state, U, dp, T)[0]
        for report in twins
    )
    Q_max = np.abs(ours).max()
    assert np.isfinite(ours).all()
    assert np.abs(theirs - ours).max() <= bound * Q_max
    assert twins[0][name].structure == twins[1][name].structure


def test_units_beside_the_headings_need_no_configuration(samples, twins, tmp_path):
    t, U, p1, p2, Q, T = samples
    file = tmp_path / "headed.csv"
    foreign = (t, U / 100, p1 * 1e5, p2 / PSI, Q / 60, T + 273.15)
    file.write_text(columns("Time,u (1),P1 [Pa],p2 / psi,Q_l/s,temp [K]", foreign))
    found = replay([file])["Valvistor"]["RLS"]
    for name, value in twins[0]["RLS"].parameters.items():
        assert found.parameters[name] == pytest.approx(value, rel=1e-8)


@pytest.mark.parametrize(
    ("heading", "said"),
    [
        ("t,U,p1 [psi],p2,Q", "says psi, signals.p1.unit of valve V7 says bar"),
        ("t,U [mA],p1,p2,Q", "is raw, in mA: signals.U.raw and .range of valve V7 must say"),
        ("t,U,p1,p2,Q [bar]", "bar is a unit of pressure, Q is a flow"),
        ("t,U,p1,p2,Q [furlong]", "'furlong' is no unit known here; signals.Q.unit may be one of"),
    ],
)
def test_a_heading_that_contradicts_the_configuration_is_refused(tmp_path, heading, said):
    file, config = tmp_path / "r.csv", tmp_path / "c.toml"
    file.write_text(heading + "\n0,1,2,3,4\n")
    config.write_text('[[valves]]\nname = "V7"\n[valves.signals]\np1 = { unit = "bar" }\n')
    with pytest.raises(ConfigurationError) as caught:
        replay([file], load_config(config))
    assert said in str(caught.value)
    assert str(caught.value).startswith(f"{file}, line 1: column ")


def test_a_wide_file_holds_several_valves_and_a_narrow_one_names_them(tmp_path, capsys):
    config = tmp_path / "c.toml"
    valves = "".join(
        f'[[valves]]\nname = "{name}"\n[valves.signals]\n'
        + "".join(f'{s} = {{ column = "{name}.{s}" }}\n' for s in ("U", "p1", "p2", "Q"))
        for name in ("A", "B")
    )
    config.write_text(valves)
    wide, narrow = tmp_path / "wide.csv", tmp_path / "narrow.csv"
    rng = np.random.default_rng(1)
    U, dp = rng.uniform(5, 100, (2, 500))
    zero, t = np.zeros(500), np.arange(500) * 0.1
    of_A, of_B = (U, dp, zero, 0.1 * U * np.sqrt(dp)), (U, dp, zero, 0.2 * U * np.sqrt(dp))
    heading = "t," + ",".join(f"{name}.{s}" for name in "AB" for s in ("U", "p1", "p2", "Q"))
    wide.write_text(columns(heading, (t, *of_A, *of_B)))
    report = replay([wide], load_config(config))
    assert [round(report[name]["RLS"].parameters["a4"], 6) for name in "AB"] == [0.1, 0.2]
    narrow.write_text("t,U,p1,p2,Q\n0,1,2,3,4\n")
    with pytest.raises(RecordingError, match=r"column 'A\.U' \(signals\.U\.column of valve A\)"):
        replay([narrow], load_config(config))
    config.write_text('[[valves]]\nname = "A"\n[[valves]]\nname = "B"\n')
    assert run(["replay", str(narrow), "--config", str(config)]) == 1
    assert "whose rows are these? 2 valves are configured" in capsys.readouterr().err
