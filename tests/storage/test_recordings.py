import errno
import gzip
import lzma
import os
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import valvemap.storage
from valvemap.errors import RecordingError, StorageError
from valvemap.model.samples import Samples
from valvemap.storage.csv_recordings import CsvReader
from valvemap.storage.layout import Layout
from valvemap.storage.recording_writer import RecordingWriter
from valvemap.storage.recordings import read_recording

FORMS = ["csv", "csv.gz", "csv.xz", "parquet"]
FIELDS = ("t", "U", "p1", "p2", "Q", "T", "quality")


def some_samples(n=5, start=0, seed=0):
    rng = np.random.default_rng(seed)
    U, p1, p2, Q, T = rng.normal(size=(5, n)) * 100
    T[::3] = np.nan
    t = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(start, start + n)
    return Samples.of(t, U, p1, p2, Q, T, rng.integers(0, 3, n))


def read(path, **options):
    parts = {}
    for valve, samples in read_recording(path, **options):
        parts.setdefault(valve, []).append(samples)
    return {valve: Samples.concatenate(samples) for valve, samples in parts.items()}


def assert_same_bits(a, b):
    for name in FIELDS:
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name
        assert getattr(a, name).dtype == getattr(b, name).dtype, name


def written(path, text):
    data = text.encode() if isinstance(text, str) else text
    path.write_bytes(data)
    return path


@pytest.fixture
def csv_file(tmp_path):
    return lambda text, name="r.csv": written(tmp_path / name, text)


# -- round trips


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("chunk_rows", [1, 3, 1000])
def test_what_is_written_reads_back_as_the_same_bits(tmp_path, form, chunk_rows):
    path = tmp_path / f"rig.{form}"
    one, two = some_samples(7), some_samples(5, seed=1)
    with RecordingWriter(path) as recording:
        recording.append("V1", one[:3])
        recording.append("V,2 \"ö'", two)
        recording.append("V1", one[3:])
        recording.append("V1", Samples.empty())
    back = read(path, chunk_rows=chunk_rows)
    assert list(back) == ["V1", "V,2 \"ö'"]
    assert_same_bits(back["V1"], one)
    assert_same_bits(back["V,2 \"ö'"], two)
    assert [file.name for file in tmp_path.iterdir()] == [f"rig.{form}"]


@pytest.mark.parametrize("form", FORMS)
def test_samples_are_of_the_types_that_kernels_are_compiled_for_ahead(tmp_path, form):
    path = tmp_path / f"rig.{form}"
    with RecordingWriter(path) as recording:
        recording.append("V1", some_samples(7))
    for _, samples in read_recording(path):
        for name in FIELDS:
            column = getattr(samples, name)
            assert column.flags.writeable, name  # numba takes read-only arrays for another type
            assert column.flags.c_contiguous, name


any_float = st.floats().map(lambda x: np.nan if np.isnan(x) else x)


@given(
    hnp.arrays(np.float64, (4, 5), elements=any_float),
    hnp.arrays(np.int64, 4, elements=st.integers(-(2**63) + 1, 2**63 - 1)),
)
def test_any_number_survives_every_form(tmp_path_factory, values, t):
    U, p1, p2, Q, T = values.T
    samples = Samples.of(t, U, p1, p2, Q, T)
    for form in ("csv", "parquet"):
        path = tmp_path_factory.mktemp("r") / f"rig.{form}"
        with RecordingWriter(path) as recording:
            recording.append("V", samples)
        assert_same_bits(read(path)["V"], samples)


# -- what a CSV file may look like


def test_the_smallest_recording(csv_file):
    back = read(csv_file("t,U,p1,p2,Q\n0,10,200,100,5\n0.01,20,200,90,9.5\n"))["Valvistor"]
    assert back.t.tolist() == [0, 10_000_000]
    assert back.Q.tolist() == [5.0, 9.5]
    assert np.isnan(back.T).all()
    assert back.quality.tolist() == [0, 0]


def test_columns_may_stand_in_any_order_and_others_are_passed_over(csv_file):
    path = csv_file("Q,operator,valve,p2,p1,U,quality,t,T\n5,Ann,V7,100,200,10,Bad,1,40\n")
    with read_recording(path) as recording:
        assert recording.ignored == ("operator",)
        ((valve, samples),) = recording
    assert valve == "V7"
    assert (samples.U, samples.p1, samples.p2, samples.Q, samples.T) == (10, 200, 100, 5, 40)
    assert samples.quality == 2


@pytest.mark.parametrize(
    "text",
    [
        "\ufefft,U,p1,p2,Q,T\r\n0.5,1.5,2,3,4,\r\n",
        "t;U;p1;p2;Q;T\n0,5;1,5;2;3;4;\n",
        "t;U;p1;p2;Q;T\n0.5;1.5;2;3;4;nan\n",
        "t\tU\tp1\tp2\tQ\tT\n0.5\t1.5\t2\t3\t4\t\n",
        't, U, p1, p2, Q, T\n0.5, 1.5, 2, 3, 4, ""\n',
        '"t","U","p1","p2","Q","T"\n"0.5","1.5","2","3","4","nan"\n',
        "t,U,p1,p2,Q,T\n\n0.5,1.5,2,3,4,\n\n",
        "t,U,p1,p2,Q,T\n0.5,1.5,2,3,4,",
    ],
)
def test_spreadsheets_of_all_countries_are_read(csv_file, text):
    back = read(csv_file(text))["Valvistor"]
    assert (back.t, back.U, back.p1, back.p2, back.Q) == (500_000_000, 1.5, 2, 3, 4)
    assert np.isnan(back.T)


def test_a_packed_recording_of_other_tools_is_read(csv_file):
    text = b"t,U,p1,p2,Q\n0,10,200,100,5\n"
    for name, pack in (("r.csv.gz", gzip.compress), ("r.csv.xz", lzma.compress)):
        assert read(csv_file(pack(text), name))["Valvistor"].Q == 5


# -- bad CSV files, one clear line each

HEADER = "t,U,p1,p2,Q\n"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "r.csv is empty: a recording begins with t,U,p1,p2,Q"),
        (HEADER, "r.csv holds no samples"),
        (HEADER + "\n\n", "r.csv holds no samples"),
        (
            "t,U,p1,Q\n0,1,2,3\n",
            "r.csv, line 1: column p2 is missing; the header must hold t,U,p1,p2,Q (and may hold T",
        ),
        ("0,1,2,3,4\n", "r.csv, line 1: column t, U, p1, p2, Q is missing"),
        ("t,U,U,p1,p2,Q\n0,1,2,3,4,5\n", "r.csv, line 1: column U stands there twice"),
        (
            HEADER + "0,1,2,3,4\n1,1,bar,3,4\n",
            "r.csv, line 3: p1 is 'bar', allowed is a number, nan or an empty cell",
        ),
        (
            HEADER + "0,1,2,3,4\n\n1,1,2,3,bar\n",
            "r.csv, line 4: Q is 'bar', allowed is a number, nan or an empty cell",
        ),
        (
            HEADER + "0,1,2,3,4\nnoon,1,2,3,4\n",
            "r.csv, line 3: t is 'noon', allowed is an ISO 8601 time",
        ),
        (HEADER + ",1,2,3,4\n", "r.csv, line 2: t is '', allowed is an ISO 8601 time"),
        (
            HEADER + "0,1,2,3,4\n0,1,2\n",
            "r.csv, line 3: 3 cells separated by comma where the header has 5",
        ),
        (
            HEADER + "0,5,1,5,2,3,4\n",
            "r.csv, line 2: 7 cells separated by comma where the header has 5",
        ),
        (
            "t,E,p1@1,5,200,1e1,40\n1,1.5,200,99,1e1,40\n2,2.5,200,98,1e1,40\n",
            "r.csv, line 1: column U, p1, p2, Q is missing",
        ),
        (
            "t,U<p1,p2,Q,T\n0,0.5,1,2,3\n1,4.5_2,1,2,3\n",
            "r.csv, line 1: column U, p1 is missing",
        ),
        (
            "t;U;p1;p2;Q\n0;1.00,5;2;3;4\n",
            "r.csv, line 2: U is '1.00.5', allowed is a number",
        ),
        (
            "t,U,p1,p2,Q,quality\n0,1,2,3,4,192\n",
            "r.csv, line 2: quality is '192', allowed is 0, 1, 2, Good",
        ),
        ("t,U,p1,p2,Q,valve\n0,1,2,3,4,\n", "r.csv, line 2: valve is '', allowed is a name"),
        (b"\xff\xfet\x00,\x00U\x00", "r.csv, line 1: column p1, p2, Q is missing"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "r.csv is not a recording: no UTF-8 text behind line 0"),
        ("x" * 1_000_000, "r.csv, line 1: column t, U, p1, p2, Q is missing"),
        (HEADER + "0,1,2,3," + "4" * 200_000, "r.csv is cut off or damaged behind line"),
    ],
)
def test_a_bad_csv_file_is_refused_in_one_line(csv_file, text, sentence):
    path = csv_file(text)
    with pytest.raises(RecordingError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path.parent}/{sentence}".replace("//", "/"))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) - len(str(path)) < 350


def test_the_line_of_an_error_is_right_in_a_later_chunk(csv_file):
    lines = ["0,1,2,3,4"] * 50
    lines[41] = "0,1,2,3,x"
    path = csv_file(HEADER + "\n".join(lines))
    with pytest.raises(RecordingError, match="line 43: Q is 'x'"):
        read(path, chunk_rows=7)


def test_a_file_that_is_missing_or_of_another_kind_is_named(tmp_path):
    for name in ("no.csv", "no.parquet", "no.parquet.part"):
        with pytest.raises(RecordingError, match=f"{name} does not exist"):
            read_recording(tmp_path / name)
    with pytest.raises(RecordingError, match=r"r\.xlsx is not a recording: its name must end in"):
        read_recording(tmp_path / "r.xlsx")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(RecordingError, match=r"folder\.csv cannot be read"):
        read_recording(tmp_path / "folder.csv")


@pytest.mark.parametrize("form", ["csv.gz", "csv.xz"])
def test_rows_before_the_truncation_of_a_packed_file_are_handed_out(tmp_path, form):
    path = tmp_path / f"r.{form}"
    with RecordingWriter(path) as recording:
        for n in range(40):
            recording.append("V", some_samples(100, 100 * n, n))
            if n % 10 == 9:
                recording.flush()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) - 200])
    rows = 0
    with pytest.raises(RecordingError, match=r"is cut off or damaged behind line [1-9]"):  # noqa: PT012
        for _, samples in read_recording(path, chunk_rows=1000):
            rows += len(samples)
    assert 3000 <= rows < 4000


@pytest.mark.parametrize("form", ["csv.gz", "csv.xz"])
def test_a_file_that_is_not_packed_as_its_name_says_is_refused(csv_file, form):
    path = csv_file(HEADER + "0,1,2,3,4\n", f"r.{form}")
    with pytest.raises(RecordingError, match="is cut off or damaged behind line 0"):
        read(path)


# -- Parquet


def parquet(path, **columns):
    import pyarrow as pa
    import pyarrow.parquet as pq

    basis = {"t": [0, 1], "U": [1.0, 2], "p1": [2.0, 2], "p2": [3.0, 3], "Q": [4.0, 4]}
    basis |= columns
    pq.write_table(pa.table({k: v for k, v in basis.items() if v is not None}), path)
    return path


def test_parquet_columns_may_be_of_any_type_that_fits(tmp_path):
    import pyarrow as pa

    for t in (
        pa.array([10**6, 2 * 10**6], pa.timestamp("us")),
        pa.array([1, 2], pa.timestamp("s", "Europe/Berlin")),
        pa.array([1, 2], pa.int32()),
        pa.array([1.0, 2.0]),
        pa.array(["1970-01-01T00:00:01Z", "2"]),
    ):
        path = parquet(
            tmp_path / "r.parquet",
            t=t,
            U=pa.array([1, None], pa.int8()),
            p1=pa.array([1.5, 2.5], pa.float32()),
            T=pa.nulls(2),
            valve=pa.array(["A", "B"]).dictionary_encode(),
            quality=pa.array(["Good", "Bad"]),
            remark=["x", "y"],
        )
        with read_recording(path) as recording:
            assert recording.ignored == ("remark",)
            back = dict(recording)
        assert list(back) == ["A", "B"]
        assert [int(back[v].t[0]) for v in "AB"] == [10**9, 2 * 10**9]
        assert back["A"].U == 1
        assert np.isnan(back["B"].U)
        assert back["B"].p1 == 2.5
        assert back["B"].quality == 2


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        ({"p2": None}, "column p2 is missing; the header must hold t,U,p1,p2,Q"),
        ({"U": ["1", "2"]}, "column U is of type string, not a number"),
        (
            {"t": [True, False]},
            "column t is of type bool, not a timestamp, a duration, a number or text",
        ),
        ({"valve": [1, 2]}, "column valve is of type int64, not text"),
        ({"t": [0, None]}, "row 2: t is '', allowed is an ISO 8601 time"),
        ({"t": [0, 10**12]}, "row 2: t is '1000000000000', allowed is an ISO 8601 time"),
        ({"quality": [0, 192]}, "row 2: quality is '192', allowed is 0, 1, 2"),
        ({"valve": ["V", ""]}, "row 2: valve is '', allowed is a name"),
        ({"valve": ["V", None]}, "row 2: valve is '', allowed is a name"),
    ],
)
def test_a_bad_parquet_file_is_refused_in_one_line(tmp_path, columns, sentence):
    path = parquet(tmp_path / "r.parquet", **columns)
    with pytest.raises(RecordingError) as caught:
        read(path, chunk_rows=1)
    assert sentence in str(caught.value)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize("content", [b"", b"PAR1", b"t,U,p1,p2,Q\n" * 100, None])
def test_a_broken_parquet_file_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / "r.parquet"
    if content is None:
        content = parquet(path).read_bytes()[:-20]
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"r\.parquet is not a recording") as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_parquet_pages_that_are_damaged_are_said(tmp_path):
    path = tmp_path / "r.parquet"
    with RecordingWriter(path) as recording:
        recording.append("V", some_samples(1000))
    data = bytearray(path.read_bytes())
    data[100 : len(data) // 2] = b"\x00" * (len(data) // 2 - 100)
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=r"r\.parquet is (damaged|not a recording)"):
        read(path)


def test_a_time_beyond_every_calendar_is_refused_in_one_line(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet as pq

    path = tmp_path / "r.parquet"
    table = {name: [1.0] for name in ("U", "p1", "p2", "Q")}
    table["t"] = pa.array([2**62], pa.timestamp("us", "UTC"))
    pq.write_table(pa.table(table), path)
    with pytest.raises(RecordingError, match=r"row 1: t is '4611686018427387904', allowed is"):
        read(path)


def test_a_damaged_cell_of_parquet_is_said(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet as pq

    from valvemap.storage.parquet_recordings import open_parquet

    path = tmp_path / "r.parquet"
    table = {name: [1.0, 2.0] for name in ("t", "U", "p1", "p2", "Q")} | {"valve": ["a", "b"]}
    pq.write_table(pa.table(table), path)
    reader = open_parquet(path, 100, Layout())
    (batch,) = reader._batches
    names = pa.DictionaryArray.from_arrays(pa.array([0, 144]), pa.array(["a"]), safe=False)
    place = batch.schema.names.index("valve")
    columns = [names if k == place else batch.column(k) for k in range(batch.num_columns)]
    reader._batches = [pa.RecordBatch.from_arrays(columns, names=batch.schema.names)]
    with pytest.raises(RecordingError, match="is not a recording: Index 144 out of bounds"):
        list(reader.chunks())
    reader.close()


def test_without_pyarrow_parquet_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    for name in ("arrow_columns", "arrow_reader", "arrow_streams", "parquet_recordings"):
        monkeypatch.delitem(sys.modules, f"valvemap.storage.{name}", raising=False)
        monkeypatch.delattr(valvemap.storage, name, raising=False)
    for use in (read_recording, RecordingWriter):
        with pytest.raises(RecordingError, match=r"pip install 'valvemap\[parquet\]'"):
            use(tmp_path / "r.parquet")
    assert list(tmp_path.iterdir()) == []


# -- progress and memory


@pytest.mark.parametrize("form", FORMS)
def test_progress_runs_from_nothing_to_one(tmp_path, form):
    path = tmp_path / f"r.{form}"
    with RecordingWriter(path) as recording:
        for n in range(20):
            recording.append("V", some_samples(1000, 1000 * n, n))
    with read_recording(path, chunk_rows=500) as recording:
        seen = [recording.fraction for _ in recording]
        assert recording.fraction == 1.0
    assert seen == sorted(seen)
    assert len(seen) == 40
    assert 0 < seen[0] < 0.6
    assert seen[-1] == 1.0
    assert all(0 <= fraction <= 1 for fraction in seen)


def test_progress_bears_a_file_that_is_closed_while_it_is_asked(csv_file):
    reader = CsvReader(csv_file(HEADER + "0,1,2,3,4\n"), "", 100, Layout())
    os.close(reader._raw.fileno())  # as another thread does, between a look and a question
    assert reader.fraction == 1.0
    with pytest.raises(OSError, match="Bad file descriptor"):
        reader._raw.close()


def test_a_reader_that_is_closed_early_has_ended(csv_file):
    with read_recording(csv_file(HEADER + "0,1,2,3,4\n" * 100), chunk_rows=1) as recording:
        next(recording)
    assert list(recording) == []


# -- what a writer does when things go wrong


def test_a_recording_appears_under_its_name_only_when_it_is_complete(tmp_path):
    path = written(tmp_path / "r.csv", "the old one")
    recording = RecordingWriter(path)
    recording.append("V", some_samples())
    assert path.read_text() == "the old one"
    assert_same_bits(read(tmp_path / "r.csv.part")["V"], some_samples())
    recording.close()
    recording.close()
    assert_same_bits(read(path)["V"], some_samples())


WRITER = textwrap.dedent("""
    import sys
    import numpy as np
    from valvemap.model.samples import Samples
    from valvemap.storage.recording_writer import RecordingWriter

    recording = RecordingWriter(sys.argv[1])
    for n in range(10_000_000):
        recording.append("V", Samples.of(*np.full((5, 50), n)))
        if sys.argv[1].endswith("z"):
            recording.flush()
        print(n, flush=True)
""")


@pytest.mark.parametrize("form", FORMS)
def test_a_killed_writer_leaves_every_batch_behind(tmp_path, form):
    path = tmp_path / f"r.{form}"
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True
    ) as writer:
        for _ in range(20):
            n = int(writer.stdout.readline())
        writer.send_signal(getattr(signal, "SIGKILL", signal.SIGTERM))
        n = int((writer.stdout.read().split() or [n])[-1])

    kept = tmp_path / f"r.{form}.1.part"
    RecordingWriter(path).close()
    U = []
    try:
        for _, samples in read_recording(kept, chunk_rows=50):
            U.extend(samples.U.tolist())
    except RecordingError:
        pass  # the kill fell into a write
    expected = np.repeat(np.arange(n + 1.0), 50)
    assert U[: len(expected)] == expected.tolist()


class FullDisk:
    """A file on a disk that has room for so many bytes more."""

    def __init__(self, file, room):
        self._file = file
        self.room = room

    def write(self, block):
        if self.room == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        count = self._file.write(block[: min(self.room, 1000)])
        self.room -= count
        return count

    def __getattr__(self, name):
        return getattr(self._file, name)


@pytest.mark.parametrize("form", FORMS)
def test_a_full_disk_is_said_and_nothing_written_is_lost(tmp_path, form):
    path = tmp_path / f"r.{form}"
    recording = RecordingWriter(path)
    recording._file = FullDisk(recording._file, 40_000)
    kept = 0
    with pytest.raises(StorageError) as caught:  # noqa: PT012 - the disk fills somewhere in here
        while True:
            recording.append("V", some_samples(100, 100 * kept, kept))
            kept += 1
    assert str(caught.value) == f"{path} cannot be written: No space left on device"

    recording._file.room = 10**6
    recording.append("V", some_samples(100, 100 * kept, kept))
    recording.close()
    whole = Samples.concatenate([some_samples(100, 100 * n, n) for n in range(kept + 1)])
    assert_same_bits(read(path)["V"], whole)


def test_a_disk_that_stays_full_leaves_the_rows_that_fitted(tmp_path):
    path = tmp_path / "r.csv"
    recording = RecordingWriter(path)
    recording.append("V", some_samples(3))
    recording._file = FullDisk(recording._file, 150)
    with pytest.raises(StorageError):
        recording.append("V", some_samples(100))
    recording.close()
    assert_same_bits(read(path)["V"], some_samples(3))


@pytest.mark.parametrize("form", FORMS)
def test_a_place_that_cannot_be_written_is_named(tmp_path, form):
    path = tmp_path / "nowhere" / f"r.{form}"
    with pytest.raises(StorageError, match=r"nowhere.r\..* cannot be written: No such file"):
        RecordingWriter(path)


def test_a_recording_of_an_unknown_kind_is_refused(tmp_path):
    with pytest.raises(RecordingError, match=r"r\.txt is not a recording"):
        RecordingWriter(tmp_path / "r.txt")
    with pytest.raises(RecordingError, match=r"does not end in \.part"):
        RecordingWriter(tmp_path / "r.csv.part")
