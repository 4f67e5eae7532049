"""Tiers are those of the raw values: after kills, damage, late rows, and from older files."""

import sqlite3
import subprocess
import sys
import zlib
from contextlib import closing

import numpy as np
import pytest

from support.soaked import soaked
from valvemap.pipeline.store_ports import Piece
from valvemap.storage.history import HistoryFile
from valvemap.storage.history_blocks import CODES, T, base_of
from valvemap.storage.history_cells import FIELDS, WIDTHS, as_past, cells_of, name_of

S = 1_000_000_000
START = 1_700_000_100 * S
SERIES = "V1.Signals"
EVER = -(2**63), 2**63 - 1


def piece(first, n, seed=0, series=SERIES):
    k = np.arange(first, first + n)
    values = np.round(100.0 + np.random.default_rng(seed + first).normal(0.0, 0.4, n), 1)
    codes = np.where(k % 97 == 0, 0x8000_0000, 0).astype(np.uint32)
    return Piece(series, START + k * S // 10, codes, {"Q": values, "U": np.full(n, 5.0)})


@pytest.fixture
def path(tmp_path):
    return tmp_path / "history.sqlite"


def saved(store, n, first=0, each=50):
    for start in range(first, first + n, each):
        store.save([piece(start, each), piece(start, each, series="V2.Signals")])


def settling(store):
    """Save nothing until all repairs are done."""
    for k in range(99):
        if store._database.tiers_are_whole:
            return
        yield k
        store.save([])
    raise AssertionError("repairs do not end")


def check_tiers(store, rows=None):
    """Compare both tiers with the raw values of the file."""
    list(settling(store))
    for series in (SERIES, "V2.Signals"):
        past = store.read(series, "Q", *EVER, most=10**9)
        assert rows is None or len(past.t) == rows
        for width in WIDTHS:
            found = store.cells(series, "Q", START - 10**15, START + 10**15, width)
            columns = {T: past.t, CODES: past.codes, "Q": past.values}
            extent = int(past.t[0]), int(past.t[-1])
            expected = as_past(cells_of(columns, width), "Q", extent)
            assert found.extent == extent
            for name in ("t", "rows", "good", "uncertain", "low", "high", "marks"):
                np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)
            np.testing.assert_allclose(found.total, expected.total, rtol=1e-13)


def test_they_are_those_of_the_values_also_of_late_ones(path):
    with HistoryFile(path) as store:
        saved(store, 6_000)
        saved(store, 6_000, first=12_000)
        check_tiers(store, 12_000)
        saved(store, 6_000, first=6_000)
        check_tiers(store, 18_000)
    with HistoryFile(path) as store:
        check_tiers(store, 18_000)
        saved(store, 500, first=18_000)
        check_tiers(store, 18_500)


def test_what_the_service_states_of_itself_is_good_while_the_results_are_uncertain(path):
    codes = np.repeat(np.array([0, 0x4000_0000, 0x8000_0000], np.uint32), 100)
    columns = {"Residual": np.ones(300), "Status": np.repeat([0.0, 6.0, 3.0], 100)}
    with HistoryFile(path) as store:
        store.save([Piece("V1.RLS", START + np.arange(300) * S // 10, codes, columns)])
        list(settling(store))
        assert store.read("V1.RLS", "Status", *EVER, most=999).codes.tolist() == [0] * 300
        assert store.read("V1.RLS", "Residual", *EVER, most=999).codes.tolist() == codes.tolist()
        span = START, START + 30 * S, WIDTHS[0]
        assert store.cells("V1.RLS", "Status", *span).high.tolist() == [0.0, 6.0, 3.0]
        assert store.cells("V1.RLS", "Residual", *span).good.tolist() == [100, 0, 0]


def test_values_are_read_again_bit_by_bit(path):
    odd = np.random.default_rng(0).integers(0, 2**64, 5_000, np.uint64).view(np.float64)
    given = Piece(SERIES, START + np.arange(5_000), np.zeros(5_000, np.uint32), {"Q": odd})
    with HistoryFile(path) as store:
        store.save([given])
        found = store.read(SERIES, "Q", *EVER, most=10**9)
        assert found.values.tobytes() == odd.tobytes()
        np.testing.assert_array_equal(found.t, given.t)


@pytest.mark.parametrize("seed", [*soaked(0, 2), 1])
def test_after_a_kill_at_any_time_they_are_those_of_the_values(path, seed):
    script = (
        "import os, sys, threading, time; sys.path[:0] = 'tests', 'tests/storage'\n"
        "from test_history_tiers import *\n"
        f"store = HistoryFile({str(path)!r})\n"
        "saved(store, 4000, each=500)\n"
        f"kill = lambda: (time.sleep({0.05 + 0.11 * seed}), os.kill(os.getpid(), 9))\n"
        "threading.Thread(target=kill, daemon=True).start()\n"
        "saved(store, 400000, first=4000, each=700)\n"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == -9
    with HistoryFile(path) as store:
        check_tiers(store)
        first = len(store.read(SERIES, "Q", *EVER, most=10**9).t)
        saved(store, 4_200, first=first, each=700)
        check_tiers(store, first + 4_200)


def parts_of(path, series, column):
    with closing(sqlite3.connect(path)) as file, file:
        return file.execute(
            "SELECT part.block, part.name FROM part JOIN block ON block.id = part.block "
            "JOIN name AS s ON s.id = series JOIN name AS c ON c.id = part.name "
            "WHERE s.name = ? AND c.name = ?",
            (series, column),
        ).fetchall()


@pytest.mark.parametrize("field", ["n", *(name_of("Q", field) for field in FIELDS), "t"])
def test_a_damaged_tier_is_made_anew(path, field):
    with HistoryFile(path) as store:
        saved(store, 9_000, each=500)
    for width in ("10s", "300s"):
        for block, name in parts_of(path, f"{SERIES}#{width}", field)[:1]:
            with closing(sqlite3.connect(path)) as file, file:
                spoil = "UPDATE part SET data = zeroblob(90) WHERE block = ? AND name = ?"
                file.execute(spoil, (block, name))
    with HistoryFile(path) as store:
        check_tiers(store, 9_000)


def test_of_a_file_set_aside_they_are_those_of_the_values(path):
    with HistoryFile(path) as store:
        saved(store, 9_000, each=500)
    content = path.read_bytes()
    path.write_bytes(b"\xa5" * 4_096 + content[4_096:])
    with HistoryFile(path) as store:
        check_tiers(store, 9_000)
        assert store.lost == 0


def as_version_2(path):
    """Rewrite a file as version 2 did: no tiers, no column packed."""
    with HistoryFile(path) as store:
        rows = store._database.rows
        names = {number: name for name, number in rows.names.items()}
        blocks = store._database.writer.execute("SELECT id, series, first FROM block").fetchall()
        for block, series, first in blocks:
            name = names[series]
            if base_of(name) == name and "#" in name:
                rows._delete([block])
                continue
            found = rows.examined(store._database.writer, name, block)
            rows._delete([block])
            rows._insert(base_of(name), dict(found.columns))
            assert first == found.t[0]
        store._database.writer.execute("PRAGMA user_version = 2")
        store._database._chores.close()


class Clock:
    def __init__(self, step):
        self.now, self.step = 0.0, step

    def __call__(self):
        self.now += self.step
        return self.now


def test_an_older_file_is_packed_a_block_with_each_save_and_read_meanwhile(path):
    with HistoryFile(path) as store:
        saved(store, 30_000, each=500)
        expected = store.read(SERIES, "Q", *EVER, most=10**9)
        saved(store, 500, first=30_000, each=500)
    as_version_2(path)
    size = path.stat().st_size
    with HistoryFile(path, clock=Clock(0.6)) as store:
        assert store.cells(SERIES, "Q", START, START + 10**12, WIDTHS[0]) is None
        for _ in settling(store):
            found = store.read(SERIES, "Q", *EVER, most=30_000)
            np.testing.assert_array_equal(found.values, expected.values)
            np.testing.assert_array_equal(found.t, expected.t)
        check_tiers(store, 30_500)
        assert store.lost == 0
        assert store.size < size / 3


def test_a_checksum_of_zeros_is_no_column(path):
    with HistoryFile(path) as store:
        saved(store, 5_000, each=500)
        assert zlib.crc32(b"") == 0
    for block, name in parts_of(path, f"{SERIES}#", "Q"):
        with closing(sqlite3.connect(path)) as file, file:
            file.execute(
                "UPDATE part SET data = x'', digest = 0 WHERE block = ? AND name = ?", (block, name)
            )
    with HistoryFile(path) as store:
        assert store.lost > 0


def test_tiers_outlive_their_values(path):
    clock = Clock(0.0)
    with HistoryFile(path, keep_s=100.0, trend_s=1_000.0, clock=clock) as store:
        saved(store, 9_000, each=500)
        before = store.cells(SERIES, "Q", START, START + 10**12, WIDTHS[1])
        store.forget()
        clock.now += 200.0
        store.forget()
        assert not len(store.read(SERIES, "Q", *EVER, most=9).t)
        after = store.cells(SERIES, "Q", START, START + 10**12, WIDTHS[1])
        whole = before.t < START + 8_000 * S // 10
        np.testing.assert_array_equal(after.total[: whole.sum()], before.total[whole])
        clock.now += 1_000.0
        store.forget()
        assert store.cells(SERIES, "Q", START, START + 10**12, WIDTHS[1]) is None
