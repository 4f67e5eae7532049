"""A damaged history: the service starts, readable rows are read again, lost rows are counted."""

import sqlite3
import subprocess
import sys
from contextlib import closing

import numpy as np
import pytest

from support.soaked import soaked
from valvemap.errors import StorageError
from valvemap.pipeline.alarm_results import AlarmChange, AlarmReport
from valvemap.pipeline.store_ports import Piece
from valvemap.storage import history_database
from valvemap.storage.history import HistoryFile
from valvemap.storage.sqlite_files import MOST_SET_ASIDE

EVER = -(2**63), 2**63 - 1
SERIES = [f"V{n}.{part}" for n in (1, 2) for part in ("Signals", "RLS")]
COLUMNS = ("U", "p1", "Q")
ROWS = 4_600
CHANGES = [
    AlarmChange("V1", t, AlarmReport("LagFound", True, False, 300, t, t, 1, f"came at {t}"))  # noqa: FBT003
    for t in range(200)
]


def piece(series, start, n):
    t = 10 * np.arange(start, start + n, dtype=np.int64) + SERIES.index(series)
    rng = np.random.default_rng(t[0])
    columns = {name: rng.normal(size=n) for name in COLUMNS}
    return Piece(series, t, (t % 3).astype(np.uint32), columns)


def pieces():
    """A large block, then small ones, of each series."""
    yield [piece(series, 0, 4_200) for series in SERIES]
    for start in range(4_200, ROWS, 100):
        yield [piece(series, start, 100) for series in SERIES]


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """The bytes of a file, and all that it holds."""
    path = tmp_path_factory.mktemp("history") / "history.sqlite"
    with HistoryFile(path) as store:
        for saved in pieces():
            store.save(saved)
        store.note(CHANGES)
        held = {(s, c): whole(store, s, c) for s in SERIES for c in COLUMNS}
    return path.read_bytes(), held


@pytest.fixture
def path(tmp_path):
    return tmp_path / "history.sqlite"


def whole(store, series, column):
    return store.read(series, column, *EVER, most=10**9)


def readable(store, held):
    """Which rows of each column can be read; no value is read that was not saved."""
    found = {}
    for key, past in held.items():
        rows = whole(store, *key)
        rows = rows[: np.searchsorted(rows.t, 10 * ROWS)]
        places = np.searchsorted(past.t, rows.t)
        for name in ("t", "values", "codes"):
            np.testing.assert_array_equal(getattr(rows, name), getattr(past, name)[places], key)
        found[key] = np.isin(past.t, rows.t, assume_unique=True)
    return found


def missing(found):
    """Rows of which a column cannot be read."""
    return sum(int((~np.all([found[s, c] for c in COLUMNS], axis=0)).sum()) for s in SERIES)


def flipped(content, rng, flips, low=0, high=None):
    hurt = bytearray(content)
    for place in rng.integers(low, high or len(hurt), flips):
        hurt[place] ^= 1 << int(rng.integers(8))
    return bytes(hurt)


@pytest.mark.parametrize("starts", [15, pytest.param(60, marks=pytest.mark.soak)])
@pytest.mark.parametrize("flips", [1, 40])
def test_each_start_with_flipped_bits_goes_ahead_and_counts_what_is_lost(
    kept, flips, starts, tmp_path
):
    content, held = kept
    rows, columns = len(SERIES) * ROWS, len(SERIES) * len(COLUMNS)
    salvaged = 0
    for seed in range(starts):
        path = tmp_path / f"{seed}.sqlite"
        path.write_bytes(flipped(content, np.random.default_rng(seed), flips))
        with HistoryFile(path) as store:
            found = readable(store, held)
            assert missing(found) <= 1.01 * store.lost, seed  # a number of rows may be hit itself
            assert store.lost <= rows, seed
            salvaged += sum(map(np.sum, found.values()))
            store.save([Piece("V1.Signals", np.array([10**9]), np.zeros(1, np.uint32), {})])
            aside = [p for p in tmp_path.glob(f"{seed}.sqlite.damaged-*") if p.suffix == ".sqlite"]
            assert store.take_notes() or not (aside or store.lost), seed  # nothing is silent
        with HistoryFile(path) as store:
            assert store.lost == 0, "counted once"
            assert readable(store, held).keys() == found.keys()
    share = salvaged / (starts * ROWS * columns)
    assert share >= (0.93 if flips == 1 else 0.05)  # of 12 large columns each has three flips


HIGH_OF_VERSION = 62  # bytes 60 to 63 are the version; of the last two a flip may be a newer one


@pytest.mark.parametrize("every", [3, *soaked(1)])
def test_with_any_byte_of_the_header_spoilt_it_starts_and_nothing_is_lost(kept, path, every):
    content, held = kept
    for place in (
        n for n in range(0, 100, every) if n not in (HIGH_OF_VERSION, HIGH_OF_VERSION + 1)
    ):
        path.write_bytes(changed(content, place, 0x80 if place % 2 else 0x01))
        with HistoryFile(path) as store:
            assert missing(readable(store, held)) == store.lost == 0, place
        for other in path.parent.glob("*"):
            other.unlink()
    path.write_bytes(changed(content, HIGH_OF_VERSION + 1, 4))
    with pytest.raises(StorageError, match="newer valvemap"):
        HistoryFile(path)


def changed(content, place, bits):
    hurt = bytearray(content)
    hurt[place] ^= bits
    return bytes(hurt)


def test_with_the_whole_first_page_gone_all_is_taken_over(kept, path):
    content, held = kept
    path.write_bytes(b"\xa5" * 4_096 + content[4_096:])
    with HistoryFile(path) as store:
        found = readable(store, held)
        assert missing(found) == store.lost == 0
        assert store.changes("V1", *EVER, most=999) == CHANGES
        (note, done) = store.take_notes()
    (aside,) = (p for p in path.parent.glob("*.damaged-*Z"))
    assert aside.name in note
    assert f"{len(SERIES) * ROWS:,} rows are copied; 0 rows lack columns or all" in done


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.6, 0.99])
def test_a_file_cut_short_starts_and_counts_what_its_table_knows(kept, share, path):
    content, held = kept
    path.write_bytes(content[: int(share * len(content))])
    with HistoryFile(path) as store:
        found = readable(store, held)
        assert missing(found) <= store.lost or share < 0.3  # tables too are gone


def damaged_blocks(path):
    """Overwrite the upper half of the file, as a broken disk does."""
    size = path.stat().st_size
    with path.open("r+b") as file:
        file.seek(size // 8192 * 4096)
        file.write(b"\xa5" * (size // 4))


def test_damage_while_it_runs_costs_at_most_what_is_damaged(path):
    with HistoryFile(path) as store:
        for saved in pieces():
            store.save(saved)
    with HistoryFile(path, clock=Clock()) as store:
        held = {(s, c): whole(store, s, c) for s in SERIES for c in COLUMNS}
        store._database.reader.execute("PRAGMA cache_size = 0")
        store._database.past._remembered.clear()
        damaged_blocks(path)
        readable(store, held)  # the first query finds the damage
        store.save([piece(SERIES[0], ROWS, 5)])
        found = readable(store, held)
        assert len(whole(store, SERIES[0], "Q").t) >= 5
        assert store.lost >= missing(found) > 0
        assert "is set aside" in store.take_notes()[0]


class Clock:
    """``step`` seconds pass with each reading."""

    def __init__(self, step=0.0):
        self.now, self.step = 0.0, step

    def __call__(self):
        self.now += self.step
        return self.now


def test_a_large_file_is_taken_over_a_little_with_each_save(kept, path):
    content, held = kept
    path.write_bytes(b"\xa5" * 4_096 + content[4_096:])
    with HistoryFile(path, clock=Clock(step=0.3)) as store:
        assert missing(readable(store, held)) > 10_000
        for k in range(500):
            store.save([piece(SERIES[0], ROWS + k, 1)])
        assert missing(readable(store, held)) == store.lost == 0
        assert len(whole(store, SERIES[0], "Q").t) == ROWS + 500


def test_a_kill_while_it_is_taken_over_loses_nothing(kept, path):
    content, held = kept
    path.write_bytes(b"\xa5" * 4_096 + content[4_096:])
    script = (
        "import os, sys; sys.path[:0] = ['tests/storage', 'tests']\n"
        "from test_history_damage import *\n"
        f"store = HistoryFile({str(path)!r}, clock=Clock(step=0.3))\n"
        "for k in range(5): store.save([piece(SERIES[0], ROWS + k, 1)])\n"
        "os.kill(os.getpid(), 9)\n"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == -9
    with HistoryFile(path) as store:
        found = readable(store, held)
        assert missing(found) == store.lost == 0
        assert len(whole(store, SERIES[0], "Q").t) == ROWS + 5
    assert not list(path.parent.glob("*.salvaging"))


def test_rows_that_came_meanwhile_are_not_doubled(kept, path):
    content, _ = kept
    path.write_bytes(b"\xa5" * 4_096 + content[4_096:])
    with HistoryFile(path, clock=Clock(step=2.0)) as store:
        assert not len(whole(store, SERIES[0], "Q").t)
        store.save([piece(SERIES[0], ROWS - 50, 100)])  # its source sent 50 of them again
        for _ in range(500):
            store.save([])
        t = store.read(SERIES[0], "Q", *EVER, most=10**9).t
        assert (np.diff(t) > 0).all()
        assert len(t) == ROWS + 50


def test_a_damaged_disk_does_not_fill_with_files_set_aside(kept, path):
    content, _ = kept
    for _ in range(MOST_SET_ASIDE + 3):
        path.write_bytes(b"\xa5" * 4_096 + content[4_096:])
        HistoryFile(path).close()
    assert len(list(path.parent.glob("*.first-page"))) == MOST_SET_ASIDE
    assert len(list(path.parent.iterdir())) == 2 * MOST_SET_ASIDE + 1


def test_damage_right_after_damage_is_an_error_instead_of_an_endless_round(path):
    with HistoryFile(path, clock=Clock()) as store:
        error = sqlite3.DatabaseError("malformed")
        error.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
        store._database.mend(error)
        with pytest.raises(sqlite3.DatabaseError, match="malformed"):
            store._database.mend(error)


def test_only_its_owner_mends_a_file(kept, path):
    content, _ = kept
    path.write_bytes(b"\xa5" * 4_096 + content[4_096:])
    with pytest.raises(StorageError, match=r"history\.sqlite cannot be used: .*database"):
        HistoryFile(path, mends=False)
    assert [p.name for p in path.parent.iterdir()] == ["history.sqlite"]


def test_a_kill_while_the_file_is_made_does_not_make_it_anothers(path):
    with closing(sqlite3.connect(path)) as half, half:
        half.execute("CREATE TABLE name (id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE)")
    with HistoryFile(path) as store:
        store.save([piece(SERIES[0], 0, 5)])
        assert len(whole(store, SERIES[0], "Q").t) == 5


def test_names_survive_a_save_that_was_not_possible(path):
    with HistoryFile(path) as store:
        torn = Piece("V1.Signals", np.array([1]), np.zeros(1, np.uint32), {"Q": None})
        with pytest.raises(TypeError):
            store.save([torn])
        store.save([piece(SERIES[0], 0, 5)])
        assert len(whole(store, SERIES[0], "Q").t) == 5


def test_when_no_new_file_can_be_made_a_later_save_makes_it(path, monkeypatch):
    with HistoryFile(path, clock=Clock()) as store:
        store.save([piece(SERIES[0], 0, 5)])
        damage = sqlite3.DatabaseError("malformed")
        damage.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
        with monkeypatch.context() as patched:
            full = OSError(28, "full")
            patched.setattr(
                history_database, "open_to_write", lambda _: (_ for _ in ()).throw(full)
            )
            with pytest.raises(OSError, match="full"):
                store._database.mend(damage)
        with pytest.raises(StorageError, match="closed"):
            whole(store, SERIES[0], "Q")
        store.save([piece(SERIES[0], 5, 5)])
        assert len(whole(store, SERIES[0], "Q").t) == 10
