"""Demands from a spreadsheet, and their answers."""

import numpy as np
import pytest

from valvemap.errors import StorageError
from valvemap.storage.points import read_points


@pytest.mark.parametrize(
    "text",
    [
        "Q,dp,T\n20.5,100,45\n60,50.25,\n",
        "T;dp;Q\n45;100;20,5\n;50,25;60\n",
        "\ufeffQ\tdp\tT\r\n20,5\t100\t45\r\n60\t50,25\t\r\n",
    ],
    ids=["commas", "semicolons and decimal commas", "tabs"],
)
def test_demands_are_read_as_spreadsheets_write_them(tmp_path, text):
    file = tmp_path / "demands.csv"
    file.write_text(text, encoding="utf-8")
    Q, dp, T = read_points(file)
    assert (Q.tolist(), dp.tolist()) == ([20.5, 60.0], [100.0, 50.25])
    assert T[0] == 45.0
    assert np.isnan(T[1])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "line 1: no column Q"),
        ("Q;p\n1;2\n", "line 1: no column dp"),
        ("Q;dp\n1;x\n", "line 2: dp = 'x'; a number is wanted"),
        ("Q;dp\n1;\n", "line 2: dp is missing"),
    ],
)
def test_a_wrong_demand_is_named_by_its_line(tmp_path, text, said):
    file = tmp_path / "demands.csv"
    file.write_text(text)
    with pytest.raises(StorageError, match=said):
        read_points(file)
