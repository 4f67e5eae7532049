"""`replay --save`, `invert` and `export` as a control engineer calls them."""

import csv
import json
import subprocess
import sys

import numpy as np
import pytest

from support.soaked import soaked
from valvemap.cli import run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recording of eq. (7) with a valve called V1, and the models saved from it."""
    folder = tmp_path_factory.mktemp("models")
    rng = np.random.default_rng(1)
    U, dp = rng.uniform(0, 100, 1500), rng.uniform(1, 200, 1500)
    Q = 0.1 * U * np.sqrt(dp) + 0.2 * rng.normal(size=1500)
    lines = [f"{k / 100},V1,{U[k]},200,{200 - dp[k]},{Q[k]},40" for k in range(1500)]
    text = "\n".join(["t,valve,U,p1,p2,Q,T", *lines]) + "\n"
    (folder / "plant.csv").write_text(text, encoding="utf-8")
    assert run(["replay", str(folder / "plant.csv"), "--save", str(folder / "all")]) == 0
    return folder


def answers(file):
    with file.open(encoding="utf-8", newline="") as lines:
        return list(csv.DictReader(lines))


def test_a_replay_saves_every_map_in_a_folder_and_one_in_a_file(folder, capsys):
    names = sorted(file.name for file in (folder / "all").iterdir())
    assert names == ["V1.Auto.json", "V1.RBF.json", "V1.RLS.json", "V1.RML.json"]
    one = folder / "one.json"
    assert run(["replay", str(folder / "plant.csv"), "--save", str(one)]) == 0
    assert json.loads(one.read_text(encoding="utf-8"))["estimator"] == "Auto"
    assert f"written: {one}" in capsys.readouterr().out.replace("\n", "")


@pytest.mark.parametrize("source", ["all/V1.RLS.json", "all/V1.Auto.json", "plant.csv"])
def test_demands_from_a_file_are_answered_line_by_line(folder, source, tmp_path):
    (tmp_path / "demands.csv").write_text("dp,Q,note\n100,50,a\n25,25,b\n\n100,500,c\n")
    out = tmp_path / "answers.csv"
    demands = ["--from", str(tmp_path / "demands.csv"), "--to", str(out)]
    assert run(["invert", str(folder / source), *demands]) == 0
    first, second, beyond = answers(out)
    for row in (first, second):
        assert float(row["U"]) == pytest.approx(50.0, abs=1.0)
        assert float(row["lower"]) < float(row["U"]) < float(row["upper"])
        assert (row["status"], row["T"]) == ("OK", "40.0")
    assert (beyond["U"], beyond["status"]) == ("100.0", "ABOVE_REACH")


@pytest.mark.parametrize("name", ["Auto", "RLS", *soaked("RBF", "RML")])
def test_a_command_that_does_without_numba_answers_the_same(folder, name, tmp_path):
    model = folder / "all" / f"V1.{name}.json"
    words = ["invert", str(model), "--Q", "1,30,60,400", "--dp", "0.5,90,250", "--to"]
    assert run([*words, str(tmp_path / "here.csv")]) == 0
    own = [sys.executable, "-m", "valvemap", *words, str(tmp_path / "own.csv")]
    subprocess.run(own, check=True, capture_output=True)
    for here, there in zip(
        answers(tmp_path / "here.csv"), answers(tmp_path / "own.csv"), strict=True
    ):
        assert here.pop("status") == there.pop("status")
        for what, number in here.items():
            assert float(there[what]) == pytest.approx(float(number), rel=1e-9, nan_ok=True)


def test_what_is_unknown_is_a_dash_in_the_table(folder, tmp_path, capsys):
    saved = json.loads((folder / "all" / "V1.RLS.json").read_text(encoding="utf-8"))
    (tmp_path / "cold.json").write_text(json.dumps(saved | {"temperature": None}), encoding="utf-8")
    asked = ["invert", str(tmp_path / "cold.json"), "--Q", "50", "--dp=-100,100"]
    assert run(asked) == 0
    rows = [line.split("│")[1:-1] for line in capsys.readouterr().out.splitlines() if "│ " in line]
    cells = [[cell.strip() for cell in row] for row in rows]
    assert cells[0][:6] == ["50.00", "-100.00", "–", "–", "–", "–"]
    assert cells[1][2] == "–"
    assert cells[1][3].startswith("5")


def test_demands_on_the_command_line_are_shown_in_a_table(folder, capsys):
    model = str(folder / "all" / "V1.RLS.json")
    assert run(["invert", model, "--Q", "50,500", "--dp", "100"]) == 0
    shown = capsys.readouterr().out
    assert "V1 by RLS" in shown
    assert "ABOVE_REACH" in shown


@pytest.fixture(scope="module")
def partial(tmp_path_factory):
    """The models of a recording of a part of the map."""
    rng = np.random.default_rng(1)
    U, dp = rng.uniform(5, 40, 1500), rng.uniform(5, 60, 1500)
    Q = 9.0 * np.tanh(U / 45.0) * np.sqrt(dp) + 0.2 * rng.normal(size=1500)
    lines = [f"{k / 100},{U[k]},200,{200 - dp[k]},{Q[k]},40" for k in range(1500)]
    folder = tmp_path_factory.mktemp("partial")
    plant, models = folder / "part.csv", folder / "models"
    plant.write_text("\n".join(["t,U,p1,p2,Q,T", *lines]) + "\n", encoding="utf-8")
    assert run(["replay", str(plant), "--save", str(models)]) == 0
    return models


@pytest.mark.parametrize("estimator", ["RLS", *soaked("RBF")])
def test_a_demand_where_nothing_was_measured_is_called_extrapolating(
    estimator, partial, tmp_path, capsys
):
    model, out = str(partial / f"Valvistor.{estimator}.json"), tmp_path / "answers.csv"
    asked = ["invert", model, "--Q", "20,45", "--dp", "30"]
    assert run([*asked, "--to", str(out)]) == 0
    inside, outside = answers(out)
    assert inside["status"] == "OK"
    assert outside["status"] in ("EXTRAPOLATING", "NOT_MONOTONE")
    assert run([*asked, "--T", "60", "--to", str(out), "--force"]) == 0
    assert answers(out)[0]["status"] == "EXTRAPOLATING"
    capsys.readouterr()
    few = ["--points-q", "9", "--points-dp", "7"]
    assert run(["export", model, "--to", str(tmp_path / "t.c"), "--dp-max", "150", *few]) == 0
    assert "% of the points are extrapolated, and marked so" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("form", "size", "options"),
    [
        ("csv", "41 x 31", []),
        ("c", "9 x 7", ["--points-q", "9", "--points-dp", "7"]),
        ("st", "7 x 9", ["--points-q", "7", "--points-dp", "9"]),
    ],
)
def test_a_model_is_exported_and_the_error_is_stated(folder, form, size, options, tmp_path, capsys):
    out = tmp_path / f"valve.{form}"
    model = str(folder / "all" / "V1.RLS.json")
    assert run(["export", model, "--to", str(out), *options]) == 0
    assert "V1 by RLS" in out.read_text(encoding="utf-8").splitlines()[0]
    assert f"{size} points at 40 °C, within" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (["invert", "all/V1.RLS.json", "--Q", "50"], 2, "give --Q and --dp, or --from"),
        (["invert", "all/V1.RLS.json", "--Q", "a", "--dp", "1"], 2, "--Q a: numbers"),
        (["invert", "nowhere.json", "--Q", "1", "--dp", "1"], 2, "nowhere.json: no such file"),
        (["invert", "plant.csv", "--Q", "1", "--dp", "1", "--valve", "X"], 2, "allowed is V1"),
        (
            ["invert", "all/V1.RLS.json", "--Q", "1", "--dp", "1", "--valve", "X"],
            2,
            "valve 'X' is not there; V1 is",
        ),
        (
            ["export", "all/V1.RLS.json", "--to", "x.xls"],
            2,
            ".xls; .csv, .c, .st, .fmu are allowed",
        ),
        (["export", "all/V1.RLS.json", "--to", "x.c", "--dp-min", "300"], 2, "300 … 200 bar"),
        (["replay", "plant.csv", "--save", "plant.csv/x"], 1, "plant.csv/x: not a directory"),
    ],
)
def test_a_mistake_is_one_line_and_an_exit_code(folder, arguments, code, sentence, capsys):
    known = {"all/V1.RLS.json", "plant.csv", "nowhere.json", "plant.csv/x"}
    told = [str(folder / a) if a in known else a for a in arguments]
    assert run(told) == code
    lines = [x for x in capsys.readouterr().err.splitlines() if x.startswith("valvemap: ")]
    assert len(lines) == 1
    assert sentence in lines[0]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "line 1: no column Q"),
        ("Q,p\n1,2\n", "line 1: no column dp"),
        ("Q,dp\n1,2\nx,3\n", "line 3: Q = 'x'; a number is wanted"),
        ("Q,dp\n1\n", "line 2: dp is missing"),
    ],
)
def test_a_mistake_in_a_file_of_demands_names_line_and_column(
    folder, text, sentence, tmp_path, capsys
):
    (tmp_path / "demands.csv").write_text(text)
    model = str(folder / "all" / "V1.RLS.json")
    assert run(["invert", model, "--from", str(tmp_path / "demands.csv")]) == 1
    assert f"demands.csv: {sentence}" in capsys.readouterr().err
