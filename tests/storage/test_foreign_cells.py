"""Numbers and times as spreadsheets, loggers and historians of any country write them."""

import gzip
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from valvemap.app.given import layout_of
from valvemap.errors import RecordingError
from valvemap.model.samples import Samples
from valvemap.plant.answers import parse_answers
from valvemap.storage.clock_times import Clock, day_and_clock, is_clock, is_day
from valvemap.storage.digit_groups import grouping_of, ungrouped
from valvemap.storage.recordings import read_recording

SECOND = 10**9
DAY = 86_400 * SECOND


def file(tmp_path, text, name="r.csv"):
    path = tmp_path / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def read(recording):
    return Samples.concatenate([samples for _, samples in read_recording(recording)])


@pytest.mark.parametrize(
    ("separator", "cell", "other"),
    [
        (";", "15.000,25", "0,5"),
        (";", "15,000.25", "0.5"),
        ("\t", "15,000.25", "0.5"),
        (",", '"15,000.25"', "0.5"),
        (";", "15 000,25", "0,5"),
        (";", "15\u00a0000,25", "0,5"),
        (";", "15\u202f000,25", "0,5"),
        (";", "15'000.25", "0.5"),
        (";", "15.000", "0,5"),
        ("\t", "15,000", "0.5"),
    ],
)
def test_digits_in_groups_are_one_number(tmp_path, separator, cell, other):
    rows = [separator.join(("0", other, cell, "1", other))] * 3
    text = "\n".join([separator.join(("t", "U", "p1 [kPa]", "p2", "Q")), *rows])
    samples = read(file(tmp_path, text))
    np.testing.assert_allclose(samples.p1, 150.0025 if "25" in cell else 150.0)
    np.testing.assert_allclose(samples.U, 0.5)


def test_a_mark_that_nothing_tells_is_the_decimal_one(tmp_path):
    samples = read(file(tmp_path, "t;U;p1;p2;Q\n0;15.000;1;1;2,125\n1;15.000;1;1;2,125\n"))
    assert samples.U[0] == 15.0
    assert samples.Q[0] == 2.125


def test_a_mark_of_groups_elsewhere_in_a_number_is_an_error(tmp_path):
    head = "t;U;p1;p2;Q\n" + "0;0,5;15.000;1;1\n" * 70
    wrong = file(tmp_path, head + "1;0,5;1.5;1;1\n")
    with pytest.raises(RecordingError, match=r"line 72: p1 is '1\.5'.*'\.' groups digits"):
        read(wrong)


def test_the_mark_of_groups_is_told_by_the_decimal_one_or_by_its_place():
    assert grouping_of(["1.234.567"]) == "."
    assert grouping_of(["1,5", "1.5"]) == ""
    assert grouping_of(["1,5", "1,234.5"]) == ""  # the file contradicts itself
    assert grouping_of(["text", "", "0.125"]) == ","
    assert list(ungrouped(["-1.234,5", "7"], ".", "U")) == ["-1234,5", "7"]


@pytest.mark.parametrize("word", ["Bad Input", "I/O Timeout", "No Data", "---", "#VALUE!", "n.a."])
def test_words_of_historians_and_spreadsheets_are_missing_numbers(tmp_path, word):
    samples = read(file(tmp_path, f"t,U,p1,p2,Q\n0,1,2,{word},4\n1,1,2,3,4\n"))
    assert np.isnan(samples.p2[0])
    assert samples.p2[1] == 3.0


@pytest.mark.parametrize(
    ("headings", "day", "clock"),
    [
        ("Datum;Uhrzeit", "31.12.2026", "23:59:5{},5"),
        ("Date;Time", "2026-12-31", "23:59:5{}.5"),
        ("Date;Clock", "12/31/2026", "11:59:5{}.5 PM"),
    ],
)
def test_a_column_of_dates_and_one_of_times_of_day_are_joined(tmp_path, headings, day, clock):
    rows = [f"{day};{clock.format(k)};1;2;3;4" for k in range(3)]
    samples = read(file(tmp_path, "\n".join([f"{headings};U;p1;p2;Q", *rows])))
    wanted = np.datetime64("2026-12-31T23:59:50.5", "ns").astype(np.int64)
    assert samples.t.tolist() == [wanted + k * SECOND for k in range(3)]


@pytest.mark.parametrize("chunk_rows", [1, 2, 100])
def test_times_of_day_alone_go_on_over_midnight(tmp_path, chunk_rows):
    times = ["23:59:59", "23:59:59.5", "0:00:00", "00:00:00.25"]
    text = "\n".join(["t,U,p1,p2,Q", *(f"{t},1,2,3,4" for t in times)])
    reader = read_recording(file(tmp_path, text), chunk_rows)
    t = np.concatenate([samples.t for _, samples in reader])
    assert (t - t[0]).tolist() == [0, SECOND // 2, SECOND, SECOND * 5 // 4]


def test_a_late_sample_across_midnight_belongs_to_the_day_before():
    clock = Clock()
    cells = ["23:59:59", "00:00:01", "23:59:59", "00:00:02"]
    assert clock.times(cells).tolist() == [
        DAY - SECOND,
        DAY + SECOND,
        DAY - SECOND,
        DAY + 2 * SECOND,
    ]
    assert clock.times(["00:00:03"]).tolist() == [DAY + 3 * SECOND]


def test_dates_and_times_of_day_are_told_apart():
    assert not is_clock("24:00:00")
    assert not is_clock("1.5")
    assert is_day("2026/1/31")
    assert not is_day("31.12-2026")
    assert day_and_clock([], 0) is None
    assert day_and_clock([["1", "2"]], 0) is None
    assert day_and_clock([["12:00:00", "2"]], 0) is None


def test_a_compressed_file_is_read_under_the_name_of_a_plain_one(tmp_path):
    text = b"t,U,p1,p2,Q\n0,1,2,3,4\n"
    assert read(file(tmp_path, gzip.compress(text))).Q[0] == 4.0
    with pytest.raises(RecordingError, match="is a workbook or an archive: save the sheet as CSV"):
        read(file(tmp_path, b"PK\x03\x04" + bytes(99)))


def test_a_file_in_another_encoding_is_told_the_right_one(tmp_path):
    text = "時刻,指令[%],上流圧力[bar],下流圧力[bar],流量[L/min]\n0,1,2,3,4\n"
    with pytest.raises(RecordingError, match="save it as CSV UTF-8"):
        read(file(tmp_path, text.encode("cp932")))


def test_columns_of_data_frames_need_names_of_their_own():
    twice = pd.DataFrame([[0, 1, 2, 3, 4, 5]], columns=["t", "U", "p1", "p2", "Q", "p1"])
    with pytest.raises(RecordingError, match="DataFrame: column p1 stands there twice"):
        read_recording(twice)
    pairs = pd.MultiIndex.from_tuples([("a", name) for name in ("t", "U", "p1", "p2", "Q")])
    with pytest.raises(RecordingError, match=r"column \('a', 't'\) has no text as its name"):
        read_recording(pd.DataFrame([[0, 1, 2, 3, 4]], columns=pairs))


def test_a_missing_column_is_told_the_words_that_name_it(tmp_path):
    text = "when,foo,p1,p2,Q\n0,1,2,3,4\n"
    with pytest.raises(RecordingError) as error:
        read(file(tmp_path, text))
    assert "--signal U=HEADING" in str(error.value)
    assert 'the times: [recording] time = "…"' in str(error.value)
    layout = layout_of(None, {"t": "when"})
    answers = replace(layout, given=parse_answers(["U=foo"], []))
    (samples,) = [s for _, s in read_recording(file(tmp_path, text), layout=answers)]
    assert samples.U[0] == 1.0
