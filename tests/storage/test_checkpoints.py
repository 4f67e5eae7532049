import re
import signal
import sqlite3
import subprocess
import sys
import textwrap
import threading
from contextlib import closing

import numpy as np
import pytest

from valvemap.errors import StorageError
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.storage import checkpoints
from valvemap.storage.checkpoints import CheckpointFile
from valvemap.storage.state_files import read_states


def checkpoint(valve="V1", estimator="RLS", **changes):
    values = {"key": "k", "t": 1, "state": b"state", "lam": 0.99, "frozen": False}
    return Checkpoint(valve, estimator, **{**values, **changes})


@pytest.fixture
def path(tmp_path):
    return tmp_path / "checkpoints.sqlite"


def test_what_was_saved_is_loaded_after_a_restart(path):
    saved = [checkpoint(estimator="RBF", lam=None, frozen=True), checkpoint(t=2**63 - 1)]
    with CheckpointFile(path) as store:
        store.save(saved)
    with CheckpointFile(path) as store:
        assert store.load() == saved
        assert store.set_aside is None


def test_states_and_factors_come_back_as_the_same_bits(path):
    state = np.random.default_rng(1).bytes(100_000) + b"\x00\xff"
    lam = np.nextafter(1.0, 0.0)
    with CheckpointFile(path) as store:
        store.save([checkpoint(state=state, lam=float(lam))])
        (loaded,) = store.load()
    assert loaded.state == state
    assert loaded.lam == lam


def test_the_newest_of_each_valve_and_estimator_is_kept(path):
    with CheckpointFile(path) as store:
        store.save([checkpoint(t=1), checkpoint(estimator="RML", t=1)])
        store.save([checkpoint(t=2, state=b"newer")])
        assert [(c.estimator, c.t) for c in store.load()] == [("RLS", 2), ("RML", 1)]


def test_a_folder_that_is_missing_is_made(tmp_path):
    with CheckpointFile(tmp_path / "a" / "b" / "c.sqlite") as store:
        assert store.load() == []


def test_a_save_is_kept_whole_or_not_at_all(path):
    with CheckpointFile(path) as store:
        store.save([checkpoint(t=1)])
        with pytest.raises(StorageError):
            store.save([checkpoint(t=2), checkpoint(valve=None)])
        assert [c.t for c in store.load()] == [1]
        store.save([checkpoint(t=3)])
        assert [c.t for c in store.load()] == [3]


def test_a_full_disk_is_said_and_nothing_saved_is_lost(path):
    with CheckpointFile(path) as store:
        store.save([checkpoint()])
        store._connection.execute("PRAGMA max_page_count = 1")
        with pytest.raises(StorageError, match=r"checkpoints\.sqlite cannot be used: .*full"):
            store.save([checkpoint(state=bytes(1_000_000))])
        assert store.load() == [checkpoint()]


def test_a_file_that_may_only_be_read_is_said(path):
    with CheckpointFile(path) as store:
        store._connection.execute("PRAGMA query_only = 1")
        with pytest.raises(StorageError, match=r"checkpoints\.sqlite cannot be used: .*readonly"):
            store.save([checkpoint()])


def test_a_lock_of_another_process_is_said(path):
    with CheckpointFile(path, timeout=0.01) as store:
        other = sqlite3.connect(path, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(StorageError, match=r"checkpoints\.sqlite cannot be used: .*locked"):
            store.save([checkpoint()])
        assert store.load() == []
        other.execute("ROLLBACK")
        other.close()
        store.save([checkpoint()])
        assert store.load() == [checkpoint()]


def test_a_folder_in_place_of_the_file_is_said(tmp_path):
    with pytest.raises(StorageError, match=f"{tmp_path.name} cannot be used"):
        CheckpointFile(tmp_path)


def test_a_file_in_place_of_the_folder_is_said(tmp_path):
    (tmp_path / "data").write_text("")
    with pytest.raises(StorageError, match=r"c\.sqlite cannot be used"):
        CheckpointFile(tmp_path / "data" / "c.sqlite")


def test_it_can_be_read_while_it_is_written(path):
    with CheckpointFile(path) as store:
        store.save([checkpoint(t=1)])
        store._connection.execute("BEGIN IMMEDIATE")
        store._connection.execute("DELETE FROM checkpoint")
        reader = sqlite3.connect(path)
        assert reader.execute("SELECT t FROM checkpoint").fetchall() == [(1,)]
        reader.close()
        store._connection.execute("ROLLBACK")


def test_any_thread_may_save(path):
    with CheckpointFile(path) as store:
        threads = [
            threading.Thread(target=store.save, args=([checkpoint(valve=f"V{n}")],))
            for n in range(8)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(store.load()) == 8


@pytest.mark.parametrize("damage", ["not sqlite", "torn pages"])
def test_a_damaged_file_is_set_aside_and_a_fresh_one_begun(path, damage):
    with CheckpointFile(path) as store:
        store.save([checkpoint(valve=f"V{n}", state=bytes(5000)) for n in range(20)])
    whole = bytearray(path.read_bytes())
    if damage == "not sqlite":
        whole[:100] = b"x" * 100
    else:
        whole[4096:40_000] = b"\xa5" * (40_000 - 4096)
    path.write_bytes(whole)

    with CheckpointFile(path) as store:
        assert re.fullmatch(
            r"checkpoints\.sqlite\.damaged-\d{8}T\d{6}Z", store.set_aside.name
        )  # when it was last written
        assert store.set_aside.read_bytes() == whole
        assert all(kept == checkpoint(valve=kept.valve, state=bytes(5000)) for kept in store.load())
        store.save([checkpoint()])
    with CheckpointFile(path) as store:
        assert store.set_aside is None
        assert checkpoint() in store.load()


def test_a_second_damaged_file_does_not_replace_the_first(path):
    for n in (1, 2):
        path.write_bytes(b"damage %d" % n * 100)
        with CheckpointFile(path) as store:
            assert store.set_aside.read_bytes() == b"damage %d" % n * 100


def test_the_database_of_another_program_is_not_touched(path):
    with closing(sqlite3.connect(path)) as other, other:
        other.execute("CREATE TABLE bookkeeping (x)")
    other.close()
    before = path.read_bytes()
    with pytest.raises(StorageError, match=r"checkpoints\.sqlite belongs to another program"):
        CheckpointFile(path)
    assert path.read_bytes() == before


def test_a_file_of_a_newer_version_is_not_touched(path):
    CheckpointFile(path).close()
    with closing(sqlite3.connect(path)) as newer, newer:
        newer.execute("PRAGMA user_version = 99")
    newer.close()
    with pytest.raises(StorageError, match=r"newer valvemap: its schema is 99"):
        CheckpointFile(path)


def test_a_closed_store_says_so(path):
    store = CheckpointFile(path)
    store.close()
    store.close()
    with pytest.raises(StorageError, match="closed"):
        store.load()


WRITER = textwrap.dedent("""
    import itertools, sys
    from valvemap.storage.checkpoints import CheckpointFile
    from valvemap.pipeline.store_ports import Checkpoint

    store = CheckpointFile(sys.argv[1])
    for t in itertools.count(1):
        store.save(
            [Checkpoint(f"V{n}", "RLS", "k", t, bytes([t % 256]) * 5000, 0.99, False)
             for n in range(100)]
        )
        print(t, flush=True)
""")


@pytest.mark.parametrize("saves", [1, 7, 30])
def test_a_process_killed_while_it_writes_leaves_the_last_whole_save(path, saves):
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True
    ) as writer:
        for _ in range(saves):
            confirmed = int(writer.stdout.readline())
        writer.send_signal(getattr(signal, "SIGKILL", signal.SIGTERM))
        confirmed = int((writer.stdout.read().split() or [confirmed])[-1])

    with CheckpointFile(path) as store:
        loaded = store.load()
        assert store.set_aside is None
    assert len(loaded) == 100
    (t,) = {c.t for c in loaded}
    assert t in (confirmed, confirmed + 1)
    assert {c.state for c in loaded} == {bytes([t % 256]) * 5000}


@pytest.mark.parametrize("seed", range(3))
def test_a_flipped_bit_costs_at_most_one_generation_and_is_never_believed(path, seed):
    rng = np.random.default_rng(seed)
    states = {t: rng.bytes(5000) for t in (1, 2)}
    names = [(valve, name) for valve in ("V1", "V2") for name in ("RLS", "RML")]
    with CheckpointFile(path) as store:
        for t, state in states.items():
            store.save([checkpoint(valve, name, t=t, state=state) for valve, name in names])
    whole = path.read_bytes()
    fresh, older = 0, 0
    for _ in range(60):
        hurt = bytearray(whole)
        place = int(rng.integers(100, len(hurt)))
        hurt[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(hurt)
        with CheckpointFile(path) as store:
            loaded = store.load()
            for kept in loaded:
                assert kept == checkpoint(
                    kept.valve, kept.estimator, t=kept.t, state=states[kept.t]
                ), place
            for valve in ("V1", "V2"):
                assert len({kept.t for kept in loaded if kept.valve == valve}) <= 1, place
            whole_again = {(k.valve, k.estimator, k.t) for k in loaded} == {
                (valve, name, 2) for valve, name in names
            }
            assert whole_again or store.damaged or store.set_aside, place  # nothing is silent
            fresh += len(loaded) < len(names)
            older += not whole_again
            if store.set_aside is not None:
                store.set_aside.unlink()
    assert older > 10
    assert fresh <= 3  # of 60: where the file's own order was hit


def test_valves_whose_samples_meet_are_loaded_from_one_save_if_one_is_damaged(path):
    """A line that is older than its edge sends samples that the edge takes for a clock's step."""
    with CheckpointFile(path) as store:
        for t in (1, 2):
            store.save([checkpoint(valve, t=t) for valve in ("Line", "Edge", "Other")])
            store.save([checkpoint("Edge", "RML", t=t)])
        store._connection.execute(
            "UPDATE checkpoint SET state = ? WHERE valve = 'Line' AND t = 2", (b"spoilt",)
        )
        apart = {(one.valve, one.estimator): one.t for one in store.load()}
        met = {one.valve: one.t for one in store.load([["Line", "Edge"], ["Other"]])}
    assert {name for name, t in apart.items() if t == 1} == {("Line", "RLS")}
    assert met == {"Edge": 1, "Line": 1, "Other": 2}


def test_with_any_byte_of_the_header_spoilt_it_starts(path):
    with CheckpointFile(path) as store:
        store.save([checkpoint(valve=f"V{n}", state=bytes(3000)) for n in range(4)])
    whole = path.read_bytes()
    for place in (n for n in range(100) if n not in (62, 63)):  # a newer version, perhaps
        for bit in (0x01, 0x80):
            hurt = bytearray(whole)
            hurt[place] ^= bit
            path.write_bytes(hurt)
            with CheckpointFile(path) as store:
                for kept in store.load():
                    assert kept == checkpoint(valve=kept.valve, state=bytes(3000)), place
                assert len(store.load()) == 4 or store.set_aside is not None, place
            for other in path.parent.glob("checkpoints.sqlite*"):
                other.unlink()


def test_a_file_cut_short_is_never_believed(path):
    with CheckpointFile(path) as store:
        for t in (1, 2):
            store.save([checkpoint(f"V{n}", t=t, state=bytes([t]) * 3000) for n in range(10)])
    whole = path.read_bytes()
    for part in np.linspace(1, len(whole) - 1, 12).astype(int).tolist():
        path.write_bytes(whole[:part])
        with CheckpointFile(path) as store:
            loaded = store.load()
            assert all(kept.state == bytes([kept.t]) * 3000 for kept in loaded)
            newest = len(loaded) == 10 and {kept.t for kept in loaded} == {2}
            assert newest or store.damaged or store.set_aside, part
            if store.set_aside is not None:
                store.set_aside.unlink()


def test_a_flipped_bit_in_the_log_is_not_silent(path, monkeypatch):
    with CheckpointFile(path) as store:
        store.save([checkpoint(t=1)])
        with monkeypatch.context() as patched:
            patched.setattr(checkpoints, "fold_log", lambda _: 0)  # killed just before
            store.save([checkpoint(t=2)])
        log = path.with_name(f"{path.name}-wal")
        whole, kept = bytearray(log.read_bytes()), path.read_bytes()
    assert len(whole) > 4096
    for place in range(40, len(whole), 997):
        hurt = bytearray(whole)
        hurt[place] ^= 4
        path.write_bytes(kept)
        log.write_bytes(hurt)
        with CheckpointFile(path) as store:
            (loaded,) = store.load()
            assert loaded == checkpoint(t=loaded.t)
            assert loaded.t == 2 or store.damaged, place


def test_a_file_of_another_format_is_set_aside(path):
    old = sqlite3.connect(path)
    old.execute("CREATE TABLE checkpoint (valve TEXT, estimator TEXT, state BLOB)")
    old.execute("INSERT INTO checkpoint VALUES ('V1', 'RLS', x'00')")
    old.execute("PRAGMA application_id = 0x766D6170")
    old.execute("PRAGMA user_version = 1")
    old.commit()
    old.close()
    with CheckpointFile(path) as store:
        assert store.set_aside is not None
        assert store.load() == []


@pytest.mark.parametrize("spoilt", [b"CREATE TABLE checkpoint", b"CREATE TABLE aside", b"INTEGER"])
def test_a_schema_that_is_no_text_is_damage(path, spoilt):
    with CheckpointFile(path) as store:
        store.save([checkpoint()])
    hurt = bytearray(path.read_bytes())
    hurt[hurt.index(spoilt) + 1] = 0xC5  # no UTF-8: Python cannot decode SQLite's message
    path.write_bytes(hurt)
    with CheckpointFile(path) as store:
        store.load()
        store.save([checkpoint()])


@pytest.mark.parametrize("seed", range(2))
def test_with_any_letter_of_the_schema_spoilt_it_starts(path, seed):
    with CheckpointFile(path) as store:
        store.save([checkpoint()])
    whole, rng = path.read_bytes(), np.random.default_rng(seed)
    first, last = whole.index(b"CREATE TABLE"), whole.rindex(b"CREATE TABLE") + 400
    for place in rng.integers(first, last, 60).tolist():
        hurt = bytearray(whole)
        hurt[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(hurt)
        with CheckpointFile(path) as store:
            assert store.load() in ([checkpoint()], []), place
            store.save([checkpoint(t=2)])
            assert store.load() == [checkpoint(t=2)], place
        for other in path.parent.glob("checkpoints.sqlite*"):
            other.unlink()


def test_a_path_may_have_any_character(tmp_path):
    path = tmp_path / "Anlage #1 50% ?" / "state.sqlite"
    with CheckpointFile(path) as store:
        store.save([checkpoint()])
    (states, _) = read_states(path)
    assert states == [checkpoint()]
