"""A state file of an older format is migrated at the start, with all that was learnt."""

import json
import lzma
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from valvemap.app.build import build_identification
from valvemap.config.models import Config
from valvemap.pipeline.kept_together import KeptValves
from valvemap.runtime.restoring import restore
from valvemap.storage.checkpoint_rows import SCHEMA_VERSION
from valvemap.storage.checkpoints import CheckpointFile
from valvemap.storage.state_files import read_states

DATA = Path(__file__).parents[1] / "data" / "states"
NAMES = ("RLS", "RML", "RBF")


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "state.sqlite"
    file.write_bytes(lzma.decompress((DATA / "schema_2.sqlite.xz").read_bytes()))
    return file


@pytest.fixture(scope="module")
def expected():
    return json.loads((DATA / "schema_2.json").read_text())


def config(**signals):
    nodes = {name: f"ns=2;s=V1.{name}" for name in ("U", "p1", "p2", "Q", "T", "sequence")}
    estimators = [{"kind": name} for name in NAMES]
    valve = {"name": "V1", "nodes": nodes, "estimators": estimators, "signals": signals}
    url = "opc.tcp://127.0.0.1:4840/plant"
    return Config.model_validate({"source": {"url": url}, "valves": [valve]})


def started(path, config):
    """Start on a file, save, and return what is known and what is set aside."""
    identification = build_identification(config)
    with CheckpointFile(path) as store:
        assert store.set_aside is None
        restore(KeptValves(identification), store, store.load())
        store.save(identification.states.kept())
        return identification.results.one(0), store.aside()


def test_it_is_read_with_all_that_was_learnt(path, expected):
    found, aside = started(path, config())
    assert {one.checkpoint.estimator for one in aside} <= {"Alarms"}  # of fewer alarms
    for name in NAMES:
        now, before = found.estimators[name], expected[name]
        assert now.sample_count == before["count"]
        assert now.theta[:6].tolist() == before["theta"]
        assert now.residual_rmse == before["rmse"]


def test_from_the_first_save_on_it_carries_its_meaning(path):
    started(path, config())
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA user_version").fetchone() == (SCHEMA_VERSION,)
    found, aside = started(path, config(Q={"unit": "gpm"}))
    assert {one.checkpoint.estimator for one in aside} >= {"RBF"}
    assert found.estimators["RLS"].sample_count == 150


def test_it_is_listed_without_being_changed(path):
    before = path.read_bytes()
    states, aside = read_states(path)
    assert {one.estimator for one in states} >= set(NAMES)
    assert not aside
    assert path.read_bytes() == before


def test_a_damaged_one_loses_only_what_is_damaged(path, expected):
    whole = bytearray(path.read_bytes())
    with closing(sqlite3.connect(path)) as connection:
        (state,) = connection.execute(
            "SELECT state FROM checkpoint WHERE estimator = 'RML'"
        ).fetchone()
    place = whole.find(state[200:600])
    whole[place] ^= 1
    path.write_bytes(whole)
    identification = build_identification(config())
    with CheckpointFile(path) as store:
        restore(KeptValves(identification), store, store.load())
        assert "V1.RML" in store.damaged
    found = identification.results.one(0).estimators
    assert found["RML"].sample_count == 0
    assert found["RLS"].theta[:6].tolist() == expected["RLS"]["theta"]
