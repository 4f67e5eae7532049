"""One process uses a state file, and a file that is lost while in use is noticed and replaced."""

import re
import shutil
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing

import pytest

from valvemap.errors import StateFileLost, StorageError
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.storage.checkpoints import CheckpointFile

HOLDER = """
import sys, time
from valvemap.storage.checkpoints import CheckpointFile
store = CheckpointFile(sys.argv[1])
print("held", flush=True)
time.sleep(60.0)
"""


def checkpoint(valve="V1", t=1):
    return Checkpoint(valve, "RLS", "k", t, b"state", lam=None, frozen=False, meaning="")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "data" / "state.sqlite"


def test_a_second_service_is_refused_in_a_line_that_names_the_first(path):
    with CheckpointFile(path), pytest.raises(StorageError) as refused:
        CheckpointFile(path)
    assert re.fullmatch(
        r"\S+state\.sqlite is in use by process \d+: each service needs a state\.file of its own",
        str(refused.value),
    )


def test_the_lock_of_a_killed_process_is_none(path):
    command = [sys.executable, "-c", HOLDER, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(StorageError, match=f"in use by process {holder.pid}"):
            CheckpointFile(path)
        holder.send_signal(signal.SIGKILL)
    with CheckpointFile(path) as store:
        store.save([checkpoint()])


def test_a_lock_file_that_is_removed_is_made_again_at_the_next_save(path):
    with CheckpointFile(path) as store:
        path.with_name("state.sqlite.lock").unlink()
        store.save([checkpoint()])
        with pytest.raises(StorageError, match="in use"):
            CheckpointFile(path)


def remove(path):
    for part in path.parent.glob("state.sqlite*"):
        part.unlink()


def remove_the_file_alone(path):
    path.unlink()


def remove_the_folder(path):
    shutil.rmtree(path.parent)


def exchange(path):
    path.rename(path.with_name("away"))
    with CheckpointFile(path.with_name("other.sqlite")) as other:
        other.save([checkpoint("other")])
    path.with_name("other.sqlite").rename(path)


def restore_a_copy(path):
    copy = path.with_name("copy")
    shutil.copy(path, copy)
    copy.replace(path)


@pytest.mark.parametrize(
    "lose", [remove, remove_the_file_alone, remove_the_folder, exchange, restore_a_copy]
)
def test_a_file_that_is_lost_is_noticed_at_the_next_save_and_replaced(path, lose):
    with CheckpointFile(path) as store:
        store.save([checkpoint(t=1)])
        lose(path)
        with pytest.raises(StateFileLost, match="removed or replaced while in use"):
            store.save([checkpoint(t=2)])
        assert store.renewed == 1
        store.save([checkpoint(t=3)])
        assert store.load() == [checkpoint(t=3)]
    with CheckpointFile(path) as store:
        assert store.load() == [checkpoint(t=3)]


def test_the_file_of_another_service_in_its_place_is_kept(path):
    with CheckpointFile(path) as store:
        store.save([checkpoint(t=1)])
        exchange(path)
        with pytest.raises(StateFileLost):
            store.save([checkpoint(t=2)])
        kept = store.set_aside
    with closing(sqlite3.connect(kept)) as other:
        assert other.execute("SELECT DISTINCT valve FROM checkpoint").fetchall() == [("other",)]


def test_a_folder_that_cannot_be_written_is_said_at_each_save(path):
    with CheckpointFile(path) as store:
        shutil.rmtree(path.parent)
        path.parent.write_text("a file where the folder was")
        for _ in range(2):
            with pytest.raises(StorageError, match=r"state\.sqlite cannot be used"):
                store.save([checkpoint()])
        path.parent.unlink()
        with pytest.raises(StateFileLost):
            store.save([checkpoint()])
        store.save([checkpoint()])
        assert store.load() == [checkpoint()]
