"""Units inside cells, and files in long format without headings, read as their plain twin."""

import numpy as np
import pytest

from support.valve_at_work import N, valve_at_work
from valvemap.errors import RecordingError
from valvemap.model.samples import Samples
from valvemap.storage.layout import Layout
from valvemap.storage.recordings import read_recording

NAMES = {"U": "Stellsignal", "p1": "Druck vor", "p2": "Druck nach", "Q": "Durchfluss"}
UNITS = {"U": "%", "p1": "kPa", "p2": "kPa", "Q": "l/min"}


@pytest.fixture(scope="module")
def plain():
    return valve_at_work()


def cell(plain, name, row):
    return plain[name][row] * (100.0 if name in {"p1", "p2"} else 1.0)


def assert_twin(path, plain):
    parts = [samples for _, samples in read_recording(path, layout=Layout())]
    samples = Samples.concatenate(parts)
    assert len(samples) == N
    for name in NAMES:
        np.testing.assert_allclose(getattr(samples, name), plain[name], rtol=1e-5)


@pytest.mark.parametrize("comma", [False, True])
@pytest.mark.parametrize("names", [NAMES, {name: name for name in NAMES}])
def test_a_unit_in_each_cell_is_the_columns_unit(tmp_path, plain, comma, names):
    lines = [";".join(["t", *names.values()])]
    for row in range(N):
        cells = [f"{cell(plain, name, row):.9g} {UNITS[name]}" for name in NAMES]
        line = ";".join([f"{plain['t'][row]:.3f} s", *cells])
        lines.append(line.replace(".", ",") if comma else line)
    path = tmp_path / "cells.csv"
    path.write_text("\n".join(lines))
    assert_twin(path, plain)


def test_a_cell_in_another_unit_than_its_column_is_refused(tmp_path, plain):
    lines = ["t,U,p1,p2,Q"]
    for row in range(N):
        unit = "MPa" if row == 400 else "bar"
        lines.append(f"{plain['t'][row]:.3f},50,{plain['p1'][row]:.6g} {unit},20,30")
    path = tmp_path / "mixed.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(RecordingError, match=r"line 402: p1 is '.* MPa'"):
        assert_twin(path, plain)


def long_lines(plain, *, order, date, of_cell):
    for row in range(N):
        t = plain["t"][row]
        time = f"2026-03-01T10:00:{t:06.3f}" if date else f"{t:.3f}"
        for name, shown in NAMES.items():
            value, unit = f"{cell(plain, name, row):.9g}", UNITS[name]
            parts = {"time": time, "tag": shown, "value": f"{value} {unit}", "unit": unit}
            if not of_cell:
                parts["value"] = value
            yield ";".join(parts[part] for part in order)


@pytest.mark.parametrize("date", [True, False])
@pytest.mark.parametrize("headings", [True, False])
@pytest.mark.parametrize(
    ("order", "of_cell"),
    [
        (("time", "tag", "value"), True),
        (("tag", "time", "value"), True),
        (("time", "tag", "value", "unit"), False),
        (("tag", "value", "unit", "time"), False),
    ],
)
def test_a_long_file_needs_no_headings_and_no_unit_in_its_names(
    tmp_path, plain, order, of_cell, headings, date
):
    lines = [";".join(order)] if headings else []
    path = tmp_path / "long.csv"
    path.write_text(
        "\n".join([*lines, *long_lines(plain, order=order, date=date, of_cell=of_cell)])
    )
    assert_twin(path, plain)
