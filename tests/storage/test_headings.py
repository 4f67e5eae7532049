"""Recordings with foreign headings are read as their plain twin, or asked about."""

import ast
import shlex

import numpy as np
import pytest

import valvemap
from support.valve_at_work import N, valve_at_work
from valvemap.cli import run
from valvemap.errors import RecordingError
from valvemap.model.samples import Samples
from valvemap.plant.answers import parse_answers
from valvemap.storage.layout import Layout
from valvemap.storage.recordings import read_recording


@pytest.fixture(scope="module")
def plain():
    return valve_at_work()


def read(path, **layout):
    parts = [samples for _, samples in read_recording(path, layout=Layout(**layout))]
    return Samples.concatenate(parts)


def assert_twin(samples, plain, *, dp_only=False, rtol=1e-6):
    assert np.array_equal(samples.t, np.rint(plain["t"] * 1e9).astype(np.int64))
    names = ("U", "Q") if dp_only else ("U", "p1", "p2", "Q")
    for name in names:
        np.testing.assert_allclose(getattr(samples, name), plain[name], rtol=rtol)
    np.testing.assert_allclose(samples.dp, plain["p1"] - plain["p2"], rtol=rtol)


def lines(heading, columns, separator=";", *, comma=True):
    rows = [separator.join(f"{x:.9g}" for x in row) for row in zip(*columns, strict=True)]
    text = "\n".join(rows)
    return f"{heading}\n{text.replace('.', ',') if comma else text}\n"


def test_semicolons_decimal_commas_and_units_in_german_headings(plain, tmp_path):
    file = tmp_path / "r.csv"
    columns = [plain["Q"], plain["t"], plain["U"], 100 * plain["p2"], 100 * plain["p1"]]
    heading = "Volumenstrom [l/min];Zeit [s];Stellsignal [%];Druck nach [kPa];Druck vor [kPa]"
    file.write_text(lines(heading, columns))
    assert_twin(read(file), plain)


def test_chinese_headings_with_units_behind_the_name_and_times_in_ms(plain, tmp_path):
    file = tmp_path / "r.csv"
    columns = [1e3 * plain["t"], plain["U"], plain["p1"] / 10, plain["p2"] / 10, plain["Q"] * 0.06]
    file.write_text(
        lines("时间[ms],阀门开度%,阀前压力MPa,阀后压力MPa,流量m3/h", columns, ",", comma=False),
        encoding="utf-8",
    )
    assert_twin(read(file), plain)


def test_long_format_in_any_order_of_rows(plain, tmp_path):
    names = {"U": "cmd [%]", "p1": "p_in [bar]", "p2": "p_out [bar]", "Q": "flow [l/min]"}
    rows = [
        f"{t:.9g},{tag},{value:.9g}"
        for role, tag in names.items()
        for t, value in zip(plain["t"], plain[role], strict=True)
    ]
    for order in (rows, sorted(rows, key=lambda row: float(row.split(",")[0]))):
        file = tmp_path / "r.csv"
        file.write_text("\n".join(["time,tag,value", *order]) + "\n")
        assert_twin(read(file), plain)


@pytest.mark.parametrize("times", ["numbers", "timestamps"])
@pytest.mark.parametrize("names", ["strings", "dictionary"])
def test_long_format_in_parquet(plain, tmp_path, times, names):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    tags = {"U": "cmd [%]", "p1": "p_in [bar]", "p2": "p_out [bar]", "Q": "flow [l/min]"}
    t = np.tile(plain["t"], len(tags))
    stamps = pa.array(np.rint(t * 1e9).astype(np.int64)).cast(pa.timestamp("ns"))
    whose = pa.array(np.repeat(list(tags.values()), len(plain["t"])))
    table = pa.table(
        {
            "time": pa.array(t) if times == "numbers" else stamps,
            "tag": whose if names == "strings" else whose.dictionary_encode(),
            "value": np.concatenate([plain[role] for role in tags]),
        }
    )
    file = tmp_path / "r.parquet"
    pq.write_table(table, file)
    assert_twin(read(file), plain)


def test_a_value_without_a_time_in_long_parquet_is_an_error_with_its_row(tmp_path):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    file = tmp_path / "r.parquet"
    times = pa.array([0.0, 0.0, 1.0, None])
    pq.write_table(pa.table({"time": times, "tag": ["p1", "Q"] * 2, "value": [1.0] * 4}), file)
    with pytest.raises(RecordingError, match="row 4"):
        read(file)


def test_a_file_without_headings_is_read_by_the_columns_that_are_named(plain, tmp_path):
    file = tmp_path / "r.csv"
    columns = [plain["t"], plain["U"], 100 * plain["p1"], 100 * plain["p2"], plain["Q"]]
    file.write_text(lines("", columns, ",", comma=False).lstrip("\n"))
    assert_twin(read(file, header=("t", "U", "p1 [kPa]", "p2 [kPa]", "Q")), plain)
    with pytest.raises(RecordingError, match="--columns=t,U,p1,p2,Q"):
        read(file)
    with pytest.raises(RecordingError, match="--columns names 2"):
        read(file, header=("t", "U"))


def test_the_pressure_drop_alone_is_enough(plain, tmp_path):
    file = tmp_path / "r.csv"
    columns = [plain["t"], plain["U"], plain["p1"] - plain["p2"], plain["Q"]]
    file.write_text(lines("t,U,dp,Q", columns, ",", comma=False))
    assert_twin(read(file), plain, dp_only=True)


def test_columns_of_two_valves_are_two_valves(plain, tmp_path):
    file = tmp_path / "r.csv"
    heads = [
        f"FCV-{n}.{name}"
        for n in (1, 2)
        for name in ("cmd [%]", "p_in [bar]", "p_out [bar]", "flow [l/min]")
    ]
    columns = [plain["t"], *[plain[r] for _ in range(2) for r in ("U", "p1", "p2", "Q")]]
    file.write_text(lines(",".join(["Time", *heads]), columns, ",", comma=False))
    assert {valve for valve, _ in read_recording(file)} == {"FCV-1", "FCV-2"}


def test_counts_are_asked_and_an_answer_reads_the_plain_twin(plain, tmp_path):
    file = tmp_path / "r.csv"
    counts = [
        np.round(plain[role] / full * 27_648)
        for role, full in (("U", 100), ("p1", 250), ("p2", 250), ("Q", 100))
    ]
    file.write_text(
        lines(
            "t,Stellwert,Druck vor,Druck nach,Durchfluss", [plain["t"], *counts], ",", comma=False
        )
    )
    with pytest.raises(RecordingError) as caught:
        read(file)
    answers = [line for line in str(caught.value).splitlines() if "answer: valvemap replay" in line]
    wanted = [
        line
        for line in answers
        if "p1=0..27648:0..250bar" in line and "Q=0..27648:0..100l/min" in line
    ]
    parts = shlex.split(wanted[0].split("answer: ")[1])[3:]
    given = parse_answers(
        [p.removeprefix("--signal=") for p in parts if p.startswith("--signal=")],
        [p.removeprefix("--scale=") for p in parts if p.startswith("--scale=")],
    )
    samples = read(file, given=given)
    np.testing.assert_allclose(samples.p1, plain["p1"], atol=0.01)
    np.testing.assert_allclose(samples.Q, plain["Q"], atol=0.01)


def test_an_answer_in_python_fits_as_the_command_does(plain, tmp_path):
    file = tmp_path / "r.csv"
    volts = [plain["t"], plain["U"] / 10.0, *(plain[name] for name in ("p1", "p2", "Q"))]
    file.write_text(lines("Zeit;Stellwert;Druck vor;Druck nach;Durchfluss", volts))
    with pytest.raises(RecordingError, match="in Python: ") as caught:
        valvemap.fit(file)
    said = [line for line in str(caught.value).splitlines() if "in Python: " in line]
    wanted = next(line for line in said if "'U': '0..10:0..100'" in line and "'Q': 'l/min'" in line)
    arguments = ast.parse(f"f({wanted.split('in Python: ')[1]})", mode="eval").body.keywords
    answer = {one.arg: ast.literal_eval(one.value) for one in arguments}
    fitted, same = valvemap.fit(file, **answer), valvemap.fit(plain)
    assert fitted.predict(50, 100) == pytest.approx(same.predict(50, 100), abs=0.1)


def test_swapped_pressures_are_asked_and_obeying_an_answer_replays(plain, tmp_path, capsys):
    file = tmp_path / "r.csv"
    columns = [plain["t"], plain["U"], plain["p2"], plain["p1"], plain["Q"]]
    file.write_text(
        lines("Zeit;Stellwert [%];Druck vor [bar];Druck nach [bar];Durchfluss [l/min]", columns)
    )
    assert run(["replay", str(file)]) == 1
    said = capsys.readouterr().err
    swapped = said.split("p1 and p2 are swapped")[1].split("answer: valvemap ")[1].splitlines()[0]
    assert run(shlex.split(swapped)) == 0


def test_missing_numbers_gaps_and_dropped_rows_have_a_line_each(plain, tmp_path, capsys):
    file = tmp_path / "r.csv"
    kept = np.r_[0:200, 300:N]
    columns = [plain[name][kept].copy() for name in ("t", "U", "p1", "p2", "Q")]
    columns[2][50:53] = np.nan
    file.write_text(lines("t,U,p1,p2,Q", columns, ",", comma=False))
    assert run(["replay", str(file)]) == 0
    said = capsys.readouterr().out
    assert "Valvistor: no number in p1 3 of 500 rows" in said
    assert "Valvistor: gaps: 1 longer than 0.25 s, the longest 5.05 s at 9.95 s" in said
    assert "Valvistor: rows dropped: 3 of 500" in said


def test_parquet_with_foreign_headings_is_recognised(plain, tmp_path):
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    table = pa.table(
        {
            "Zeit [ms]": 1e3 * plain["t"],
            "Bemerkung": ["-"] * N,
            "Consigne [%]": plain["U"],
            "Pression amont [kPa]": 100 * plain["p1"],
            "Pression aval [kPa]": 100 * plain["p2"],
            "Débit [l/min]": plain["Q"],
        }
    )
    pq.write_table(table, tmp_path / "r.parquet")
    assert_twin(read(tmp_path / "r.parquet"), plain)


@pytest.mark.parametrize(
    ("before", "below", "factor"),
    [
        ("Recorded by rig 4\nDate: 2026-01-02, 08:00\n\n", "", 1.0),
        ("# ", "", 1.0),  # as numpy.savetxt writes it
        ("# a logger's note\n", "s,%,bar,bar,l/min\n", 1.0),
        ("", "[s],[%],[kPa],[kPa],[l/min]\n", 100.0),
    ],
)
def test_notes_above_and_units_below_the_headings(plain, tmp_path, before, below, factor):
    scale = {"p1": factor, "p2": factor}
    columns = [x * scale.get(name, 1.0) for name, x in plain.items()]
    lines = [",".join(map(repr, map(float, row))) for row in zip(*columns, strict=True)]
    lines[7] = lines[7].rpartition(",")[0] + ",#N/A"
    file = tmp_path / "r.csv"
    file.write_text(f"{before}{','.join(plain)}\n{below}" + "\n".join(lines) + "\n")
    samples = read(file)
    assert np.isnan(samples.Q[7])
    Q = np.where(np.arange(N) == 7, np.nan, plain["Q"])
    assert_twin(samples, plain | {"Q": Q})
