"""What is gathered for the history, and how it is kept."""

import asyncio

import numpy as np
import pytest

from valvemap.errors import StorageError
from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.alarm_results import AlarmChange, AlarmReport
from valvemap.pipeline.by_valve import ByValve
from valvemap.pipeline.results import EstimatorResults, InverseResults, Results, SignalResults
from valvemap.pipeline.store_ports import Piece
from valvemap.runtime import past
from valvemap.runtime.past import PastKeeper
from valvemap.storage.history import HistoryFile
from valvemap.vocabulary.statuses import Quality

VALVES = ("V1", "V2", "V3")
GOOD, BAD = int(Quality.GOOD), int(Quality.BAD)


class Store:
    """Fulfils PastStore."""

    def __init__(self):
        self.pieces, self.forgotten, self.broken, self.noted = [], 0, False, []

    lost = size = 0

    def take_notes(self):
        return [f"{self.lost} rows"] if self.lost else []

    def save(self, pieces):
        if self.broken:
            raise StorageError("disk full")
        self.pieces += pieces
        return 0

    def note(self, changes):
        if self.broken:
            raise StorageError("disk full")
        self.noted += changes

    def forget(self):
        self.forgotten += 1
        return 0


def samples_of(valves, n=3, start=10):
    t = np.tile(start + np.arange(n), len(valves))
    one = np.arange(len(t), dtype=float)
    starts = n * np.arange(len(valves))
    segments = Segments(np.array(valves), starts, starts + n)
    return ByValve(Samples.of(t, one, one + 5, one, 2 * one, one + 40), segments)


def results_of(valves, t, quality=GOOD):
    M = len(valves)
    ones, codes = np.ones(M), np.full(M, quality, np.uint8)
    estimator = EstimatorResults(
        t=np.full(M, t),
        quality=codes,
        theta=np.ones((M, 2)),
        std=np.ones((M, 2)),
        predicted=2 * ones,
        residual=3 * ones,
        residual_rmse=ones,
        sample_count=np.ones(M, np.int64),
        status=codes,
        noise_std=ones,
        survey=[None] * M,
        change=[None] * M,
        structure=[None] * M,
        lags=[None] * M,
        adaptation=codes,
        systematic_std=ones,
    )
    inverse = InverseResults(
        *(np.full(M, t), codes, 50 * ones, codes, [np.ones((2, 2))] * M, np.zeros(M, bool), codes),
        *(49 * ones, 51 * ones),
    )
    signals = SignalResults(np.full(M, t), codes, np.ones((M, 6)))
    return Results(
        valves=np.array(valves),
        estimators={"RLS": estimator},
        inverse=inverse,
        counters=np.zeros((M, 1), np.int64),
        counter_names=("aligned",),
        signals=signals,
    )


@pytest.fixture
def store():
    return Store()


@pytest.fixture
def keeper(store):
    return PastKeeper(store, VALVES)


async def test_samples_are_kept_valve_by_valve_in_one_piece_each(keeper, store):
    keeper.take(samples_of([0, 2]))
    keeper.take(samples_of([2], start=20))
    await keeper.settle()
    found = {piece.series: piece for piece in store.pieces}
    assert set(found) == {"V1.Signals", "V3.Signals"}
    assert found["V3.Signals"].t.tolist() == [10, 11, 12, 20, 21, 22]
    assert found["V3.Signals"].columns["Q"].tolist() == [6.0, 8.0, 10.0, 0.0, 2.0, 4.0]
    assert set(found["V1.Signals"].columns) == {"U", "p1", "p2", "Q", "dp", "T"}


async def test_results_are_kept_part_by_part(keeper, store):
    keeper.note(results_of([0, 1], t=10))
    keeper.note(results_of([1], t=20))
    await keeper.settle()
    found = {piece.series: piece for piece in store.pieces}
    assert set(found) == {"V1.RLS", "V2.RLS", "V1.Inverse", "V2.Inverse"}
    assert found["V2.RLS"].t.tolist() == [10, 20]
    assert found["V2.RLS"].columns["Residual"].tolist() == [3.0, 3.0]
    assert found["V2.RLS"].columns["Status"].tolist() == [GOOD, GOOD]
    assert found["V1.Inverse"].columns["RequiredU"].tolist() == [50.0]
    assert found["V1.Inverse"].columns["RequiredUStatus"].tolist() == [GOOD]


async def test_what_is_lost_is_noted_right_behind_the_last_sample(keeper, store):
    keeper.note(results_of([1], t=10, quality=BAD))
    await keeper.settle()
    found = {piece.series: piece for piece in store.pieces}
    assert set(found) == {"V2.RLS", "V2.Inverse", "V2.Signals"}
    for piece in found.values():
        assert (piece.t.tolist(), piece.codes.tolist()) == ([11], [0x80000000])


async def test_of_a_valve_without_a_sample_nothing_is_noted(keeper, store):
    keeper.note(results_of([1], t=0, quality=BAD))
    await keeper.settle()
    assert store.pieces == []


async def test_changes_of_alarms_are_kept_and_no_room_for_them_is_counted(keeper, store):
    report = AlarmReport("LagFound", True, False, 300, 1, 1, 1, "it lags")  # noqa: FBT003
    changes = [AlarmChange("V1", t, report) for t in (1, 2)]
    for change in changes:
        keeper.note_alarm(change)
        await keeper.settle()
    assert store.noted == changes
    store.broken = True
    keeper.note_alarm(changes[0])
    assert not await keeper.settle()
    assert keeper.lost == 0
    keeper.end()
    assert keeper.lost == 1


async def test_it_keeps_once_a_second_and_forgets_once_a_minute(keeper, store):
    for second in range(120):
        keeper.take(samples_of([0], n=1, start=second))
        keeper.tick(float(second))
        keeper.tick(second + 0.5)
        await asyncio.wait_for(keeper._keeping, 5.0)
    assert len(store.pieces) == 120
    assert store.forgotten == 2


async def test_a_large_fleet_is_kept_less_often(store):
    keeper = PastKeeper(store, [f"V{k}" for k in range(2_000)])
    keeper.take(samples_of([0]))
    keeper.tick(0.0)
    await keeper._keeping
    keeper.take(samples_of([0], start=20))
    keeper.tick(2.0)
    assert keeper._keeping.done()
    keeper.tick(4.0)
    await keeper._keeping
    assert len(store.pieces) == 2


async def test_what_finds_no_room_is_counted(keeper, monkeypatch):
    monkeypatch.setattr(past, "MOST_ROWS", 5)
    keeper.take(samples_of([0]))
    keeper.take(samples_of([1]))
    assert keeper.lost == 3


async def test_signals_that_are_bad_find_no_room_either_and_are_counted(keeper, monkeypatch):
    monkeypatch.setattr(past, "MOST_ROWS", 0)
    keeper.note(results_of([0], t=[20], quality=BAD))
    assert keeper.lost == 3  # of RLS, of the inverse map, of the signals


async def a_second(keeper, now):
    keeper.tick(now)
    await keeper._keeping


async def test_rows_that_the_disk_refuses_wait_for_the_next_save(keeper, store):
    report = AlarmReport("LagFound", True, False, 300, 1, 1, 1, "it lags")  # noqa: FBT003
    store.broken = True
    for second in range(60):
        keeper.take(samples_of([0], start=10 * second))
        keeper.note_alarm(AlarmChange("V1", second, report))
        await a_second(keeper, float(second))
    assert (keeper.failures, keeper.lost, store.pieces) == (60, 0, [])
    store.broken = False
    keeper.take(samples_of([0], start=600))
    await a_second(keeper, 60.0)
    (piece,) = store.pieces
    assert piece.t.tolist() == [10 * second + k for second in range(61) for k in range(3)]
    assert [change.t for change in store.noted] == list(range(60))
    assert keeper.lost == 0


@pytest.mark.parametrize("seconds", [22, 60])
async def test_a_full_disk_loses_no_row(tmp_path, seconds):
    """Of the real file, whose pages are limited for a while."""
    with HistoryFile(tmp_path / "history.sqlite") as store:
        keeper = PastKeeper(store, VALVES)
        for second in range(seconds + 20):
            if second == 10:
                (pages,) = store._database.writer.execute("PRAGMA page_count").fetchone()
                store._database.writer.execute(f"PRAGMA max_page_count = {pages}")
            if second == 10 + seconds:
                store._database.writer.execute("PRAGMA max_page_count = 1000000")
            keeper.take(samples_of([0, 1, 2], n=100, start=100 * second))
            keeper.note(results_of([0, 1, 2], t=100 * second + 99))
            await a_second(keeper, float(second))
        assert keeper.failures > seconds / 2
        assert keeper.counters.lost == 0
        for valve in VALVES:
            found = store.read(f"{valve}.Signals", "Q", 0, 10**9, most=10**9)
            assert len(found.t) == 100 * (seconds + 20)
            assert len(store.read(f"{valve}.RLS", "Residual", 0, 10**9, most=10**9).t) == (
                seconds + 20
            )


async def test_rows_that_wait_and_rows_that_are_lost_are_measured_for_the_alarm(
    keeper, store, monkeypatch
):
    monkeypatch.setattr(past, "MOST_ROWS", 30)
    keeper.take(samples_of([0]))
    await a_second(keeper, 1.0)
    assert keeper.waits_s(1.5) == 0.0
    store.broken = True
    for second in range(2, 13):
        keeper.take(samples_of([0], start=10 * second))
        await a_second(keeper, float(second))
        if second < 12:
            assert keeper.waits_s(second + 0.5) == second - 1.5
    assert keeper.waits_s(12.5) == float("inf")  # once: a row found no room
    assert keeper.waits_s(13.0) == 11.0
    store.broken = False
    await a_second(keeper, 14.0)
    assert keeper.waits_s(14.0) == 0.0


async def test_rows_beyond_the_buffer_are_counted_while_the_disk_refuses(
    keeper, store, monkeypatch
):
    monkeypatch.setattr(past, "MOST_ROWS", 30)
    store.broken = True
    for second in range(20):
        keeper.take(samples_of([0], start=10 * second))
        await a_second(keeper, float(second))
    store.broken = False
    await a_second(keeper, 20.0)
    assert (keeper.lost, sum(len(piece.t) for piece in store.pieces)) == (30, 30)


async def test_rows_that_cannot_be_saved_at_the_end_are_counted(keeper, store):
    store.broken = True
    keeper.take(samples_of([0]))
    assert not await keeper.settle()
    keeper.end()
    assert (keeper.failures, keeper.lost) == (1, 3)


async def test_rows_that_wait_are_saved_after_a_reload_under_their_names(keeper, store):
    store.broken = True
    keeper.take(samples_of([0, 2]))
    keeper.note(results_of([1], t=11))
    keeper.note_axis([Piece("Boom", np.array([5]), np.zeros(1, np.uint32), {"x": np.ones(1)})])
    keeper.tick(0.0)  # it saves while the configuration is reloaded
    await keeper.follow(("V3", "V9"))
    keeper.take(samples_of([0, 1], start=20))
    keeper.note_axis([Piece("Boom", np.array([6]), np.zeros(1, np.uint32), {"v": np.ones(1)})])
    store.broken = False
    assert await keeper.settle()
    found = {}
    for piece in store.pieces:
        found.setdefault(piece.series, []).extend(piece.t.tolist())
    first, second = [10, 11, 12], [20, 21, 22]
    signals = [found[f"{name}.Signals"] for name in ("V1", "V3", "V9")]
    assert signals == [first, first + second, second]
    assert (found["V2.RLS"], found["Boom"]) == ([11], [5, 6])
    keeper.end()
    assert keeper.lost == 0


async def test_what_damage_took_is_counted_with_the_rest_and_said(keeper, store, capsys):
    store.lost = 7
    await keeper.settle()
    assert keeper.counters.lost == 7
    assert "history damaged" in (said := capsys.readouterr().out)
    assert "7 rows" in said
