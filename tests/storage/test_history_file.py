"""The file of what signals and results have been."""

import sqlite3
import subprocess
import sys
import zlib
from contextlib import closing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from valvemap.errors import StorageError
from valvemap.pipeline.alarm_results import AlarmChange, AlarmReport
from valvemap.pipeline.store_ports import Piece
from valvemap.storage import alarm_changes, history_series
from valvemap.storage.history import HistoryFile
from valvemap.storage.history_blocks import unpack
from valvemap.storage.history_cells import width_of
from valvemap.storage.history_write_states import BLOCK
from valvemap.storage.packing import MOST_ROWS

EVER = -(2**63), 2**63 - 1
S = 1_000_000_000


def piece(start, n, series="V1.Signals", columns=("U", "Q"), step=1):
    t = start + step * np.arange(n, dtype=np.int64)
    values = {name: t + k / 8 for k, name in enumerate(columns)}
    return Piece(series, t, (t % 3).astype(np.uint32), values)


def noise(start, n, step=1):
    """Two columns that cannot be packed."""
    rng, t = np.random.default_rng(start), start + step * np.arange(n, dtype=np.int64)
    values = {name: rng.normal(size=n) for name in ("U", "Q")}
    return Piece("V1.Signals", t, np.zeros(n, np.uint32), values)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "kept" / "history.sqlite"


def whole(store, series="V1.Signals", column="Q", **how):
    return store.read(series, column, *EVER, most=10**9, **how)


def test_what_was_saved_is_read_again_after_a_restart(path):
    with HistoryFile(path) as store:
        store.save([piece(0, 10), piece(0, 5, "V2.Signals")])
        store.save([piece(10, 10)])
    with HistoryFile(path) as store:
        store.save([piece(20, 10)])
        found = whole(store)
        np.testing.assert_array_equal(found.t, np.arange(30))
        np.testing.assert_array_equal(found.values, np.arange(30) + 1 / 8)
        np.testing.assert_array_equal(found.codes, np.arange(30) % 3)
        assert len(whole(store, "V2.Signals").t) == 5


def test_what_is_not_newer_is_left_out_and_counted(path):
    with HistoryFile(path) as store:
        store.save([piece(0, 10)])
        assert store.save([piece(5, 10)]) == 2 * 5
    with HistoryFile(path) as store:
        assert store.save([piece(12, 5)]) == 2 * 3
        np.testing.assert_array_equal(whole(store).t, np.arange(17))


def changed(t, owner="V1", name="LagFound", count=1):
    report = AlarmReport(name, True, False, 300, t, t, count, f"came at {t}")  # noqa: FBT003
    return AlarmChange(owner, t, report)


def test_changes_of_alarms_are_kept_once_and_read_by_owner(path):
    mine = [changed(t) for t in (3, 1, 2)]
    with HistoryFile(path) as store:
        store.note([*mine, changed(2, "V2")])
        store.note(mine)
    with HistoryFile(path) as store:
        assert store.changes("V1", 0, 9, most=9) == [changed(t) for t in (1, 2, 3)]
        assert store.changes("V1", 2, 9, backwards=True, most=9) == [changed(3), changed(2)]
        assert len(store.changes(None, *EVER, most=9)) == 4
        assert store.changes(None, *EVER, skip=1, most=2) == [changed(2), changed(2, "V2")]


class Monotonic:
    """A clock that stands still until it is set."""

    now = 0.0

    def __call__(self):
        return self.now


def test_old_and_excessive_changes_of_alarms_are_forgotten(path, monkeypatch):
    clock = Monotonic()
    with HistoryFile(path, keep_s=10.0, clock=clock) as store:
        store.note([changed(k * S) for k in range(10)])
        store.forget()
        store.note([changed(k * S) for k in range(10, 20)])
        clock.now = 11.0
        store.forget()
        assert store.changes("V1", *EVER, most=1) == [changed(10 * S)]
        monkeypatch.setattr(alarm_changes, "MOST_CHANGES", 3)
        store.forget()
        assert [change.t // S for change in store.changes("V1", *EVER, most=99)] == [17, 18, 19]


def test_a_damaged_change_of_an_alarm_is_left_out(path):
    with HistoryFile(path) as store:
        store.note([changed(t) for t in range(5)])
    with closing(sqlite3.connect(path)) as damaging, damaging:
        spoil = "UPDATE alarm_change SET report = replace(report, 'came', 'cane') WHERE t = 2"
        damaging.execute(spoil)
    with HistoryFile(path) as store:
        assert [change.t for change in store.changes("V1", *EVER, most=3)] == [0, 1, 3]


SPANS = st.tuples(st.integers(-5, 60), st.integers(-5, 60), st.integers(0, 12), st.integers(1, 40))


@pytest.mark.parametrize(
    "report",
    ["no JSON", "5", "{}", '{"name": "LagFound"}', '{"at": "Infinity"}', "[" * 10_000],
)
def test_a_change_that_is_none_is_left_out_though_its_checksum_is_right(path, report):
    with HistoryFile(path) as store:
        store.note([changed(1), changed(2), changed(3)])
    with closing(sqlite3.connect(path)) as file, file:
        checksum = zlib.crc32(report.encode())
        file.execute(
            "UPDATE alarm_change SET report = ?, checksum = ? WHERE t = 2", (report, checksum)
        )
    with HistoryFile(path) as store:
        assert [change.t for change in store.changes(None, *EVER, most=10)] == [1, 3]


def test_a_column_that_inflates_beyond_any_block_is_refused():
    bomb = zlib.compress(bytes(8 * MOST_ROWS + 8))
    assert len(bomb) < 20_000
    for name in ("t", "codes"):
        with pytest.raises(ValueError, match="longer than any block"):
            unpack(name, bomb)


@given(
    sizes=st.lists(st.integers(1, 9), min_size=1, max_size=8),
    span=SPANS,
    backwards=st.booleans(),
)
def test_any_span_in_any_order_a_page_at_a_time(tmp_path_factory, sizes, span, backwards):
    low, high, skip, most = span
    with HistoryFile(tmp_path_factory.mktemp("h") / "f") as store:
        for start, n in zip(np.cumsum([0, *sizes]), sizes, strict=False):
            store.save([piece(int(start), n)])
        t = np.arange(sum(sizes))
        expected = t[(t >= low) & (t <= high)]
        expected = (expected[::-1] if backwards else expected)[skip : skip + most]
        found = store.read("V1.Signals", "Q", low, high, backwards=backwards, skip=skip, most=most)
        np.testing.assert_array_equal(found.t, expected)
        np.testing.assert_array_equal(found.values, expected + 1 / 8)


def blocks(path):
    with closing(sqlite3.connect(path)) as connection, connection:
        names = dict(connection.execute("SELECT id, name FROM name"))
        found = connection.execute("SELECT series, rows FROM block ORDER BY first").fetchall()
        return [rows for series, rows in found if not width_of(names[series])]


def test_small_pieces_become_large_blocks(path):
    with HistoryFile(path) as store:
        for k in range(90):
            store.save([piece(100 * k, 100)])
        assert len(whole(store).t) == 9_000
    assert blocks(path)[:2] == [BLOCK + 4, BLOCK + 4]
    assert len(blocks(path)) < 12


def test_a_column_may_come_later(path):
    with HistoryFile(path) as store:
        store.save([piece(0, 2_000, columns=("U",)), piece(2_000, 2_200)])
        assert len(whole(store, column="U").t) == 4_200
        late = whole(store)
        assert np.isnan(late.values[:2_000]).all()
        assert late.values[-1] == 4_199 + 1 / 8


def test_nothing_is_known_of_what_was_never_kept(path):
    with HistoryFile(path) as store:
        store.save([piece(0, 3)])
        assert len(whole(store, "V9.Signals").t) == len(whole(store, column="p9").t) == 0


def test_a_block_is_unpacked_once_also_while_others_are_written(path, monkeypatch):
    examined, real = [], history_series.examine
    monkeypatch.setattr(
        history_series, "examine", lambda *given: examined.append(given) or real(*given)
    )
    with HistoryFile(path) as store:
        store.save([piece(0, BLOCK), piece(0, 5, "V2.Signals")])
        store.save([piece(BLOCK, 10)])
        examined.clear()
        for _ in range(3):
            assert len(whole(store).t) == len(whole(store, backwards=True).t) == BLOCK + 10
        assert len(examined) == 2
        store.save([piece(BLOCK + 10, 10)])
        assert len(whole(store).t) == BLOCK + 20
        assert len(examined) == 3


def test_what_is_old_is_forgotten(path):
    clock = Monotonic()
    with HistoryFile(path, keep_s=50.0, clock=clock) as store:
        for k in range(10):
            store.save([piece(10 * k * S, 10, step=S)])
            clock.now += 10.0
            store.forget()
        assert whole(store).t[0] == 50 * S
        store.save([piece(100 * S, 5_000, step=S)])  # joins what is left
        assert len(whole(store).t) == 5_050


def test_rows_age_only_while_the_file_is_open(path):
    for k in range(4):
        clock = Monotonic()
        with HistoryFile(path, keep_s=25.0, clock=clock) as store:
            store.save([piece(10 * k * S, 10, step=S)])
            store.forget()
            clock.now = 10.0
            store.forget()
    with HistoryFile(path) as store:
        assert whole(store).t[0] == 20 * S  # written 20 s of open file before the last look


def test_the_rate_of_growth_is_that_of_the_rows_that_are_there(path):
    clock = Monotonic()
    with HistoryFile(path, most_bytes=2_000_000, clock=clock) as store:
        assert store.bytes_per_s == 0.0
        for k in range(500):
            store.save([noise(100 * k * S, 1_000, step=S // 10)])
            clock.now += 60.0
            store.forget()
        assert store.size < 2_300_000
        assert store.bytes_per_s == pytest.approx(14_600 / 60, rel=0.3)


DAY = 86_400 * S


@pytest.mark.parametrize("step", [-3_600 * S, 3_600 * S, -8 * DAY, 8 * DAY, -S, 1])
def test_no_row_is_lost_where_a_clock_steps(path, step):
    """Of a source whose clock steps, for good, in the middle."""
    clock, t = Monotonic(), []
    with HistoryFile(path, keep_s=7 * 86_400.0, clock=clock) as store:
        for k in range(200):
            one = piece(20_000 * DAY + k * S + (step if k >= 100 else 0), 10, step=S // 10)
            t += one.t.tolist()
            store.save([one])
            clock.now += 1.0
            if k % 60 == 0:
                store.forget()
        there = len(whole(store).t)
        assert there + store.lost == len(set(t))  # what comes twice is the same row
        found = whole(store)
        assert (np.diff(found.t) > 0).all()
        np.testing.assert_array_equal(found.t, sorted(set(t)))
        back = whole(store, backwards=True)
        np.testing.assert_array_equal(back.t[::-1], found.t)
        np.testing.assert_array_equal(back.values[::-1], found.values)
        np.testing.assert_array_equal(found.values, found.t + 1 / 8)


def test_a_sample_a_day_ahead_does_not_hold_off_the_others(path):
    with HistoryFile(path) as store:
        for k in range(360):
            store.save([piece(20_000 * DAY + 10 * k * S, 10, step=S)])
            if k == 3:
                store.save([piece(20_001 * DAY, 1)])
        found = whole(store)
        assert (len(found.t), store.lost) == (3_601, 0)
        assert found.t[-1] == 20_001 * DAY
    with HistoryFile(path) as store:
        store.save([piece(20_000 * DAY + 3_600 * S, 5_000, step=S)])
        assert len(whole(store).t) == 8_601


def test_rows_of_one_time_that_differ_are_counted(path):
    with HistoryFile(path) as store:
        store.save([piece(0, 10)])
        late = piece(5, 5)
        late.columns["Q"][:] = 7.0
        assert store.save([late]) == 2 * 5
        assert store.lost == 4  # the last one is at the last time: a repetition
        assert whole(store).values[5] == 5 + 1 / 8


def test_what_is_sent_again_is_no_loss(path):
    with HistoryFile(path) as store:
        store.save([piece(0, 50)])
        assert store.save([piece(20, 10), piece(0, 5)]) == 2 * 15
        assert store.lost == 0


@given(order=st.permutations(range(12)), span=SPANS, backwards=st.booleans())
def test_pieces_in_any_order_are_read_in_order_of_time(tmp_path_factory, order, span, backwards):
    low, high, skip, most = span
    with HistoryFile(tmp_path_factory.mktemp("h") / "f") as store:
        for k in order:
            store.save([piece(k, 4, step=12)])  # overlapping
        t = np.arange(48)
        expected = t[(t >= low) & (t <= high)]
        expected = (expected[::-1] if backwards else expected)[skip : skip + most]
        found = store.read("V1.Signals", "Q", low, high, backwards=backwards, skip=skip, most=most)
        np.testing.assert_array_equal(found.t, expected)


def test_the_oldest_goes_where_there_is_too_much(path):
    with HistoryFile(path, most_bytes=300_000) as store:
        for k in range(40):
            store.save([noise(1_000 * k, 1_000)])
            store.forget()
        assert store.size < 400_000
        assert whole(store).t[-1] == 39_999
        assert len(whole(store).t) < 20_000


def test_a_kill_loses_what_was_not_saved_alone(path):
    script = (
        "import os, sys; sys.path.insert(0, 'tests/storage')\n"
        "from test_history_file import *\n"
        f"store = HistoryFile({str(path)!r})\n"
        "for k in range(50): store.save([piece(100 * k, 100)])\n"
        "os.kill(os.getpid(), 9)\n"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == -9
    with HistoryFile(path) as store:
        np.testing.assert_array_equal(whole(store).t, np.arange(5_000))


def test_a_flipped_bit_costs_its_block_and_nothing_wrong_is_read(path):
    with HistoryFile(path) as store:
        for k in range(3):
            store.save([piece(5_000 * k, 5_000)])
    with closing(sqlite3.connect(path)) as connection, connection:
        (found,) = connection.execute("SELECT id FROM name WHERE name = 'Q'").fetchone()
        connection.execute(
            "UPDATE part SET data = zeroblob(40000) WHERE name = ? AND block = "
            "(SELECT min(id) FROM block)",
            (found,),
        )
    with HistoryFile(path) as store:
        np.testing.assert_array_equal(whole(store).t, np.arange(5_000, 15_000))


def test_a_file_of_others_is_left_alone(path):
    path.parent.mkdir()
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE theirs (x)")
    with pytest.raises(StorageError, match=r"history\.sqlite belongs to another program"):
        HistoryFile(path)


def test_a_file_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match="file"):
        HistoryFile(tmp_path / "file" / "history.sqlite")


def test_readers_do_not_wait_for_who_writes(path):
    with HistoryFile(path) as store:
        store.save([piece(0, 10)])
        with store._database.writing:
            assert len(whole(store).t) == 10
