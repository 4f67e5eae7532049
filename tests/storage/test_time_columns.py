"""The column of the times: found by its name, in the unit that its heading states."""

import numpy as np
import pytest

from valvemap.errors import RecordingError
from valvemap.storage.recordings import read_recording

N = 60
PLAIN = {
    "U": np.linspace(10.0, 90.0, N),
    "p1": np.full(N, 180.0),
    "p2": np.full(N, 40.0),
    "Q": np.linspace(5.0, 60.0, N),
    "T": 45.0 + 0.01 * np.arange(N),
}
pandas = pytest.importorskip("pandas")


def forms_of(columns, folder):
    """The same columns as CSV, Parquet, data frame, dict, and a data frame of texts."""
    frame = pandas.DataFrame(columns)
    csv, parquet = folder / "r.csv", folder / "r.parquet"
    frame.to_csv(csv, index=False)
    frame.to_parquet(parquet)
    return csv, parquet, frame, columns, frame.astype(str)


def times_of(recording):
    return np.concatenate([samples.t for _, samples in read_recording(recording)])


@pytest.mark.parametrize(
    ("heading", "per_s"),
    [
        ("t [ms]", 1e3),
        ("t [msec]", 1e3),
        ("Time (milliseconds)", 1e3),
        ("Time (ms since 1970)", 1e3),
        ("t_ms", 1e3),
        ("elapsed_ms", 1e3),
        ("czas [ms]", 1e3),
        ("Zeit in Sekunden", 1.0),
        ("Zaman [s]", 1.0),
        ("Time (UTC)", 1.0),
        ("t [usec]", 1e6),
        ("t [ns]", 1e9),
        ("Time [minutes]", 1 / 60),
        ("t [days]", 1 / 86_400),
    ],
)
def test_the_unit_of_the_times_is_as_the_heading_writes_it(heading, per_s, tmp_path):
    seconds = 20.0 * np.arange(N)
    for recording in forms_of({heading: seconds * per_s, **PLAIN}, tmp_path):
        assert np.allclose(times_of(recording), seconds * 1e9, atol=1e3)


@pytest.mark.parametrize("heading", ["t [ticks]", "Zeit [Takte]", "t [100ns]", "Time [0.1 s]"])
def test_a_unit_of_times_that_is_not_known_is_refused(heading, tmp_path):
    for recording in forms_of({heading: 20.0 * np.arange(N), **PLAIN}, tmp_path):
        with pytest.raises(RecordingError, match=r"s, ms, us, ns, min, h, d.*another unit"):
            times_of(recording)


@pytest.mark.parametrize("heading", ["Time [Europe/Berlin]", "Time [hh:mm:ss]", "t [ms]"])
def test_dates_need_no_unit(heading, tmp_path):
    dates = [f"2026-03-01T12:00:{second:02d}Z" for second in range(N)]
    for recording in forms_of({heading: dates, **PLAIN}, tmp_path):
        assert (np.diff(times_of(recording)) == 10**9).all()


def test_milliseconds_since_1970_are_the_same_times_in_every_form(tmp_path):
    ms = 1_772_366_400_123 + 20 * np.arange(N)
    for recording in forms_of({"t [ms]": ms, **PLAIN}, tmp_path):
        assert times_of(recording).tolist() == (ms * 10**6).tolist()


@pytest.mark.parametrize("heading", ["stamp", "Moment", "no name"])
def test_the_temperature_is_not_taken_for_the_time(heading, tmp_path):
    for recording in forms_of({heading: 0.02 * np.arange(N), **PLAIN}, tmp_path):
        with pytest.raises(RecordingError, match="column t is missing"):
            times_of(recording)


def test_in_capitals_T_is_the_time(tmp_path):
    seconds = 0.02 * np.arange(N)
    capitals = {"T": seconds, **{name.upper(): PLAIN[name] for name in ("U", "p1", "p2", "Q")}}
    for recording in forms_of({**capitals, "RUN": np.ones(N)}, tmp_path):
        assert np.allclose(times_of(recording), seconds * 1e9)


@pytest.mark.parametrize("zone", ["Z", " UTC", " GMT", "+00:00"])
def test_a_date_may_end_in_the_word_for_its_zone(zone, tmp_path):
    dates = [f"2026-03-01 12:00:{second:02d}.123456789{zone}" for second in range(N)]
    for recording in forms_of({"Time": dates, **PLAIN}, tmp_path):
        assert times_of(recording)[0] == 1_772_366_400_123_456_789


def test_durations_are_times_since_the_start_in_every_form(tmp_path):
    columns = {"t": np.arange(N).astype("m8[ms]"), **PLAIN}
    pandas.DataFrame(columns).to_parquet(tmp_path / "r.parquet")
    for recording in (columns, pandas.DataFrame(columns), tmp_path / "r.parquet"):
        assert times_of(recording).tolist() == (np.arange(N) * 10**6).tolist()


@pytest.mark.parametrize("kind", [float, np.float32, int, object])
def test_what_a_masked_array_masks_is_missing(kind):
    masked = np.arange(N) % 7 == 0
    Q = np.ma.masked_array(np.where(masked, 33, 40 + np.arange(N)).astype(kind), masked)
    ((_, samples),) = read_recording({"t": 0.02 * np.arange(N), **PLAIN, "Q": Q})
    assert np.isnan(samples.Q[masked]).all()
    assert samples.Q[~masked].tolist() == (40.0 + np.arange(N))[~masked].tolist()


def test_a_masked_time_is_refused():
    t = np.ma.masked_array(np.arange(N).astype("M8[s]"), np.arange(N) == 3)
    with pytest.raises(RecordingError, match="row 4: t is"):
        times_of({**PLAIN, "t": t})
