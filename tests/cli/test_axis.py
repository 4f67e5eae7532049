"""`valvemap axis`: from a recording of the rig to edges, and to a function block."""

import json

import pytest

from valvemap.cli import run

SIZES = ["--piston", "63", "--rod", "45", "--stroke", "800", "--dead", "1.2"]


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    file = tmp_path_factory.mktemp("axis") / "axis.csv.gz"
    arguments = ["rig", "--scenario", "axis", "--offline", "--record", str(file)]
    assert run([*arguments, "--duration", "70"]) == 0
    return file


def test_a_recording_becomes_edges_modulus_and_a_function_block(recording, tmp_path, capsys):
    block, out = tmp_path / "axis.st", tmp_path / "axis.json"
    arguments = ["axis", str(recording), *SIZES, "--to", str(block), "--json", str(out)]
    assert run([*arguments, "--version", "4"]) == 0
    assert "bulk modulus 0.9" in capsys.readouterr().out
    told = json.loads(out.read_text(encoding="utf-8"))["Axis"]
    assert told["status"] == "OK"
    assert told["bulk_modulus_GPa"]["value"] == pytest.approx(0.9, rel=0.02)
    assert set(told["edges"]) == {"PA", "AT", "PB", "BT"}
    text = block.read_text(encoding="utf-8")
    assert "Version := 4.0;" in text
    assert "FUNCTION_BLOCK FB_AxisRequiredU" in text


def test_position_and_command_alone_are_refused_with_the_reason(tmp_path, capsys):
    file = tmp_path / "bare.csv"
    file.write_text("t,U,x\n" + "".join(f"{k / 100},1,2\n" for k in range(99)), encoding="utf-8")
    assert run(["axis", str(file), *SIZES]) == 1
    said = capsys.readouterr().err
    assert "Add pA, pB, pS and pT" in said
    assert len(said.strip().splitlines()) == 1


def test_a_rod_thicker_than_its_piston_is_refused(recording, capsys):
    sizes = ["--piston", "40", "--rod", "45", "--stroke", "800", "--dead", "1.2"]
    assert run(["axis", str(recording), *sizes]) == 2
    assert "--rod 45 mm must be less than --piston 40 mm" in capsys.readouterr().err


def test_an_axis_that_is_not_there_is_refused_with_those_that_are(recording, capsys):
    assert run(["axis", str(recording), *SIZES, "--axis", "Boom"]) == 2
    assert "no axis Boom; allowed are Axis" in capsys.readouterr().err
