from pathlib import Path

import numpy as np

from valvemap_rig.characteristics import HEADER, curves
from valvemap_rig.circuit import Bench

GOLDEN = Path(__file__).with_name("characteristic_curves.csv")


def test_the_curves_are_those_of_the_golden_file():
    """If they should change: python -m valvemap_rig.characteristics > <the golden file>."""
    header, *lines = curves(Bench())
    golden_header, *golden_lines = GOLDEN.read_text(encoding="utf-8").splitlines()
    assert header == golden_header == HEADER
    new = np.array([line.split(",") for line in lines], dtype=float)
    golden = np.array([line.split(",") for line in golden_lines], dtype=float)
    assert new.shape == golden.shape
    different = ~np.isclose(new, golden, rtol=1e-7, atol=1e-9).all(axis=1)
    shown = [f"{a}  was  {b}" for a, b in zip(lines, golden_lines, strict=True)]
    assert not different.any(), [
        line for line, is_new in zip(shown, different, strict=True) if is_new
    ][:10]


def test_the_golden_file_rises_with_u_and_dp():
    table = np.genfromtxt(GOLDEN, delimiter=",", names=True)
    for T in np.unique(table["T_C"]):
        rows = table[table["T_C"] == T]
        Q = rows["Q_l_min"].reshape(len(np.unique(rows["U_percent"])), -1)
        assert (np.diff(Q, axis=0) >= 0).all()
        assert (np.diff(Q, axis=1) > 0).all()
