import importlib
import sys

import numpy as np
import pytest

import valvemap.report
from valvemap.cli import run
from valvemap.errors import ConfigurationError, StorageError
from valvemap.report import plots

N = 500
T_NS = np.arange(N) * 10_000_000
Q = np.linspace(-1.0, 180.0, N)
NOTHING = np.full(N, np.nan)
U, DP = np.linspace(0, 100, 11), np.linspace(0, 200, 21)
MAP = U[:, None] * np.sqrt(DP) / 7


def is_a_picture(path):
    return path.read_bytes().startswith(b"\x89PNG") and path.stat().st_size > 5_000


@pytest.mark.parametrize(
    "predictions",
    [
        {"RLS": Q + 1},
        dict.fromkeys(("RLS", "RML", "RBF", "Auto", "LSM"), Q + 1),
        {"RLS": NOTHING, "RML": np.full(N, 1e300), "RBF": np.where(Q > 50, np.inf, Q)},
    ],
)
def test_agreement_and_residuals_of_any_number_of_estimators(tmp_path, predictions):
    with np.errstate(invalid="ignore"):
        residuals = {name: Q - Q_hat for name, Q_hat in predictions.items()}
    plots.plot_agreement(tmp_path / "new folder" / "agreement.png", Q, predictions)
    plots.plot_residuals(tmp_path / "residuals.png", T_NS, residuals)
    assert is_a_picture(tmp_path / "new folder" / "agreement.png")
    assert is_a_picture(tmp_path / "residuals.png")


@pytest.mark.parametrize("n", [1, 5, 30])
@pytest.mark.parametrize("with_std", [True, False])
def test_parameters_few_or_many(tmp_path, n, with_std):
    theta = np.outer(1 - np.exp(-np.arange(N) / 50), np.arange(n))
    theta[:10] = np.nan
    std = np.full((N, n), 0.1) if with_std else None
    names = [f"a{i}" for i in range(n)]
    plots.plot_parameters(tmp_path / "parameters.png", T_NS, names, theta, std)
    assert is_a_picture(tmp_path / "parameters.png")


@pytest.mark.parametrize("flow", [MAP, np.where(MAP > 100, np.nan, MAP)])
def test_a_map_whole_or_in_parts(tmp_path, flow):
    plots.plot_map(tmp_path / "map.png", U, DP, flow, (np.full(9, 50.0), np.linspace(0, 200, 9)))
    plots.plot_map(tmp_path / "bare.png", U, DP, flow)
    assert is_a_picture(tmp_path / "map.png")
    assert is_a_picture(tmp_path / "bare.png")


@pytest.mark.parametrize("flow", [MAP * np.nan, MAP * 0])
def test_a_map_that_is_not_identified_is_an_empty_picture(tmp_path, flow):
    plots.plot_map(tmp_path / "map.png", U, DP, flow)
    assert is_a_picture(tmp_path / "map.png")


@pytest.mark.parametrize("n", [0, 1])
def test_one_sample_or_none(tmp_path, n):
    plots.plot_agreement(tmp_path / "a.png", Q[:n], {"RLS": Q[:n]})
    plots.plot_residuals(tmp_path / "r.png", T_NS[:n], {"RLS": Q[:n]})
    plots.plot_parameters(tmp_path / "p.png", T_NS[:n], ["a1"], Q[:n, None])
    assert len(list(tmp_path.iterdir())) == 3


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match=r"a\.png cannot be written"):
        plots.plot_agreement(tmp_path / "file" / "a.png", Q, {"RLS": Q})


def test_without_matplotlib_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.delitem(sys.modules, "valvemap.report.plots")
    monkeypatch.delattr(valvemap.report, "plots")
    with pytest.raises(ConfigurationError, match=r"pip install 'valvemap\[plot\]'"):
        importlib.import_module("valvemap.report.plots")


def test_a_replay_without_pictures_needs_no_matplotlib(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "valvemap.report.plots", None)
    monkeypatch.delitem(sys.modules, "valvemap.report.replay_plots", raising=False)
    assert run(["replay", "none.csv"]) == 2
    assert "none.csv" in capsys.readouterr().err
