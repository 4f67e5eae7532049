import signal
import sqlite3
import subprocess
import sys
import textwrap
import threading

import numpy as np
import pytest

from service.errors import StorageError
from service.storage.checkpoints import CheckpointFile
from service.streaming.ports import Checkpoint


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
        assert store.set_aside == path.with_name("checkpoints.sqlite.damaged-1")
        assert store.set_aside.read_bytes() == whole
        assert store.load() == []
        store.save([checkpoint()])
    with CheckpointFile(path) as store:
        assert store.set_aside is None
        assert store.load() == [checkpoint()]


def test_a_second_damaged_file_does_not_replace_the_first(path):
    for n in (1, 2):
        path.write_bytes(b"damage %d" % n * 100)
        with CheckpointFile(path) as store:
            assert store.set_aside.read_bytes() == b"damage %d" % n * 100


def test_the_database_of_another_program_is_not_touched(path):
    with sqlite3.connect(path) as other:
        other.execute("CREATE TABLE bookkeeping (x)")
    other.close()
    before = path.read_bytes()
    with pytest.raises(StorageError, match=r"checkpoints\.sqlite belongs to another program"):
        CheckpointFile(path)
    assert path.read_bytes() == before


def test_a_file_of_a_newer_version_is_not_touched(path):
    CheckpointFile(path).close()
    with sqlite3.connect(path) as newer:
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
    from service.storage.checkpoints import CheckpointFile
    from service.streaming.ports import Checkpoint

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
