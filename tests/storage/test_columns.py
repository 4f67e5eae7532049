from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvemap.storage import columns
from valvemap.storage.columns import CellError
from valvemap.vocabulary.statuses import Quality

LARGEST = 2**63 - 1
instants = st.integers(min_value=-LARGEST, max_value=LARGEST)


@given(instants)
def test_every_time_that_is_written_reads_as_the_same_ns(t):
    assert columns.times([columns.time_text(t)])[0] == t


@given(st.lists(instants))
def test_a_column_reads_as_its_cells_do(ts):
    cells = [columns.time_text(t) for t in ts]
    assert columns.times(cells).tolist() == ts


@given(
    st.datetimes(datetime(1678, 1, 2), datetime(2261, 12, 30)),  # noqa: DTZ001 - offsets follow
    st.integers(min_value=0, max_value=999),
    st.integers(min_value=-14 * 60, max_value=14 * 60),
)
def test_an_iso_time_keeps_its_ns_and_its_offset(moment, ns, minutes):
    sign, offset = "-" if minutes < 0 else "+", f"{abs(minutes) // 60:02}:{abs(minutes) % 60:02}"
    text = f"{moment:%Y-%m-%dT%H:%M:%S}.{moment.microsecond:06}{ns:03}{sign}{offset}"
    since = moment.replace(tzinfo=UTC) - datetime(1970, 1, 1, tzinfo=UTC)
    expected = since // timedelta(microseconds=1) * 1000 + ns - minutes * 60 * 10**9
    assert columns.times([text])[0] == expected


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("1970-01-01T00:00:01Z", 10**9),
        ("1970-01-01T00:00:01", 10**9),
        ("1970-01-01 00:00:01.5", 1_500_000_000),
        ("1970-01-01T00:00:01,5Z", 1_500_000_000),
        ("1970-01-02", 86_400 * 10**9),
        ("1969-12-31T23:59:59.999999999Z", -1),
        ("1970-01-01T00:00:00.0000000019Z", 1),
        ("0", 0),
        ("0.01", 10_000_000),
        ("1e-9", 1),
        ("-1.5", -1_500_000_000),
        ("999999999999999", None),
        ("1000000000000000", 10**15),
        ("1700000000123456789", 1_700_000_000_123_456_789),
        ("1700000000123456789.0", 1_700_000_000_123_456_789),
        ("1700000000.123456789", 1_700_000_000_123_456_789),
        ("", None),
        ("nan", None),
        ("inf", None),
        ("1e400", None),
        ("1_000", None),
        ("yesterday", None),
        ("21.11.2026 01:54", 1_795_226_040 * 10**9),
        ("21/11/2026 01:54", None),
        ("31.02.2026", None),
        ("2300-01-01T00:00:00Z", None),
        ("9300000000", None),
    ],
)
def test_a_time_is_iso_or_ns_or_seconds(text, ns):
    if ns is None:
        with pytest.raises(CellError, match=r"t is .*, allowed is a"):
            columns.times([text])
    else:
        assert columns.times([text]).tolist() == [ns]


def test_forms_of_time_may_be_mixed():
    cells = ["1970-01-01T00:00:02Z", "3.5", "1000000000000000"]
    assert columns.times(cells).tolist() == [2 * 10**9, 3_500_000_000, 10**15]


def test_integers_and_doubles_follow_the_same_rule_as_text():
    integers = np.array([0, 5, 10**15, 1_700_000_000_123_456_789])
    assert columns.times_of_integers(integers).tolist() == [
        0,
        5 * 10**9,
        10**15,
        1_700_000_000_123_456_789,
    ]
    doubles = np.array([-0.25, 0.01, 1_700_000_000.5, 1e15])
    assert columns.times_of_floats(doubles).tolist() == [
        -250_000_000,
        10_000_000,
        1_700_000_000_500_000_000,
        10**15,
    ]
    for bad in (np.nan, np.inf, -np.inf, 1e10, 1e300):
        with pytest.raises(CellError, match="t is "):
            columns.times_of_floats(np.array([bad]))
    for bad in (10**10, -(10**10), -(2**63)):
        with pytest.raises(CellError, match="t is "):
            columns.times_of_integers(np.array([bad]))


@given(st.lists(st.floats(allow_nan=False)))
def test_numbers_that_are_written_read_as_the_same_bits(values):
    read = columns.numbers([repr(value) for value in values], "U")
    assert read.tobytes() == np.array(values, np.float64).tobytes()


def test_an_empty_cell_is_a_missing_number():
    assert np.isnan(columns.numbers(["", " ", "nan", "NaN"], "Q")).all()


@pytest.mark.parametrize("cell", ["x", "1,5", "1_000", "12 bar", "--1", "1.2.3"])
def test_text_where_a_number_must_be_is_named(cell):
    with pytest.raises(CellError) as caught:
        columns.numbers(["1", cell], "p1")
    assert str(caught.value) == f"p1 is {cell!r}, allowed is a number, nan or an empty cell"
    assert caught.value.row == 1


def test_a_long_cell_is_shortened_in_the_sentence():
    with pytest.raises(CellError) as caught:
        columns.numbers(["x" * 10_000], "p1")
    assert len(str(caught.value)) < 150


def test_quality_is_a_number_a_word_or_a_status_code():
    cells = ["0", "1", "2", "good", "Uncertain", "BadSensorFailure", "0x80AB0000", "1083310080"]
    assert columns.qualities(cells).tolist() == [0, 1, 2, 0, 1, 2, 2, 1]
    codes = np.array([0, 1, 2, 0x40920000, 0x80000000, 0xC0000000, 0x00000480])
    assert columns.qualities_of_integers(codes).tolist() == [0, 1, 2, 1, 2, 2, 0]


@pytest.mark.parametrize("cell", ["3", "192", "-1", "", "fine", "0.0", "4294967296"])
def test_an_unknown_quality_is_named(cell):
    with pytest.raises(CellError, match=r"quality is .*, allowed is 0, 1, 2, Good") as caught:
        columns.qualities(["0", cell])
    assert caught.value.row == 1


@pytest.mark.parametrize("code", [3, 192, -1, 2**32])
def test_an_unknown_quality_code_is_named(code):
    with pytest.raises(CellError, match=f"quality is '{code}'") as caught:
        columns.qualities_of_integers(np.array([Quality.GOOD, code]))
    assert caught.value.row == 1
