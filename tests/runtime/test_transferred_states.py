"""States transferred from one configuration to the next, also while the disk is full."""

import pytest

from simulation.stores import StateFile
from valvemap.errors import StorageError
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.runtime.kept_position import POSITION
from valvemap.runtime.transferred_states import TransferredStates


def state(valve, text, estimator="RLS"):
    return Checkpoint(valve, estimator, "", 1, text.encode(), lam=None, frozen=False)


def texts(states):
    return {one.valve: one.state.decode() for one in states}


@pytest.fixture
def file():
    return StateFile()


@pytest.fixture
def store(file):
    return TransferredStates(file)


def test_before_a_reload_it_is_the_file(store, file):
    file.save([state("V1", "stored"), state("Service", "10", POSITION[1])])
    assert list(store.load()) == file.load()


def test_transferred_states_replace_stored_ones_but_for_other_valves(store, file):
    file.save(
        [state("V1", "old"), state("V2", "removed before"), state("Service", "", POSITION[1])]
    )
    store.transfer([state("V1", "new")], saved=True)
    assert texts(store.load()) == {"V1": "new", "V2": "removed before"}
    assert texts(store.load()) == {"V1": "new", "V2": "removed before"}  # after a failed start


def test_what_a_full_disk_refused_is_part_of_the_next_save(store, file):
    store.transfer([state("V1", "new"), state("V2", "removed now")], saved=False)
    file.refuses = True
    with pytest.raises(StorageError):
        store.save([state("V1", "newer")])
    store.transfer([state("V1", "newest")], saved=False)
    assert texts(store.load()) == {"V1": "newest", "V2": "removed now"}
    file.refuses = False
    store.save([state("V1", "at last")])
    assert texts(file.load()) == {"V1": "at last", "V2": "removed now"}
    file.save([state("V2", "by another process")])
    store.save([])
    assert texts(file.load())["V2"] == "by another process"


def test_what_is_set_aside_is_not_saved_again(store, file):
    file.save([state("V1", "old")])
    store.transfer([state("V1", "new")], saved=False)
    store.put_aside([(state("V1", "new"), "other nodes")], {})
    store.save([state("V3", "begins")])
    assert texts(file.load()) == {"V3": "begins"}
    assert [one.state for one, _ in file.aside] == [b"new"]


def test_a_file_that_cannot_be_read_ends_no_reload(store, file, monkeypatch):
    def gone(_together=()):
        raise StorageError("state: its volume is gone")

    monkeypatch.setattr(file, "load", gone)
    with pytest.raises(StorageError):
        store.load()
    store.transfer([state("V1", "new")], saved=False)
    assert texts(store.load()) == {"V1": "new"}


def test_damage_of_a_transferred_state_is_not_reported(store, file):
    file.damaged = ("V1.RLS", "V2.RLS")
    store.transfer([state("V1", "new")], saved=True)
    assert store.damaged == ["V2.RLS"]
