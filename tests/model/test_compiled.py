"""Compiled kernels never run with a callee of yesterday: all go through one decorator."""

from dataclasses import replace
from pathlib import Path

import pytest

from valvemap.model import kernels
from valvemap.model.kernels import warmed_up

HERE = Path(kernels.__file__).parent
MAY_ASK_NUMBA = {"plain_numba.py", "tested_numba.py"}


def test_every_kernel_is_cached_under_the_stamp_of_all_that_it_imports():
    direct = {path.name for path in HERE.glob("*.py") if "njit" in path.read_text("utf-8")}
    assert direct == MAY_ASK_NUMBA


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """A machine with an empty cache, whose processor can be exchanged."""
    monkeypatch.setattr(warmed_up.ahead, "folder", lambda: None)
    monkeypatch.setattr(warmed_up, "_nothing", _Cached(tmp_path))

    def become(host, name=None, features=None):
        monkeypatch.setattr(warmed_up.binding, "get_host_cpu_name", lambda: host)
        monkeypatch.setattr(warmed_up.config, "CPU_NAME", name)
        monkeypatch.setattr(warmed_up.config, "CPU_FEATURES", features)

    become("znver5")
    return become


class _Cached:
    def __init__(self, folder):
        self.stats = self
        self.cache_path = str(folder)


def test_a_warm_up_is_noted_for_the_machine_that_it_was_made_on(machine):
    assert not warmed_up.was_warmed_up()
    warmed_up.note_warm_up()
    assert warmed_up.was_warmed_up()
    machine("haswell")
    assert not warmed_up.was_warmed_up()


def test_one_that_was_made_for_any_machine_holds_on_any(machine):
    """As in an image, which is built here and run elsewhere."""
    machine("znver5", "generic", "")
    warmed_up.note_warm_up()
    machine("haswell", "generic", "")
    assert warmed_up.was_warmed_up()


def test_another_kernel_than_then_has_to_be_warmed_up(machine, monkeypatch):
    warmed_up.note_warm_up()
    monkeypatch.setattr(warmed_up, "_ROOMS", "model/kernels/l*.py")
    assert not warmed_up.was_warmed_up()


def test_what_a_kernel_imports_may_not_have_changed_either(machine, monkeypatch):
    samples = Path(kernels.__file__).parents[1] / "samples.py"
    warmed_up.note_warm_up()
    tree = warmed_up.TREES.of(samples, "valvemap.model.samples")
    changed = replace(tree, content="another")
    monkeypatch.setitem(warmed_up.TREES._by_file, samples, changed)
    assert not warmed_up.was_warmed_up()


def test_where_nothing_can_be_kept_nothing_is_noted(machine, monkeypatch, tmp_path):
    monkeypatch.setattr(warmed_up, "_nothing", _Cached(tmp_path / "nowhere"))
    warmed_up.note_warm_up()
    assert not warmed_up.was_warmed_up()


def test_a_wheel_that_holds_all_kernels_counts_as_warmed_up(machine, monkeypatch, tmp_path):
    came = tmp_path / "came"
    came.mkdir()
    monkeypatch.setattr(warmed_up.ahead, "folder", lambda: came)
    assert not warmed_up.was_warmed_up()
    (came / warmed_up.ahead.COMPLETE).write_text(warmed_up._stamp_of_all(), encoding="utf-8")
    assert warmed_up.was_warmed_up()
    (came / warmed_up.ahead.COMPLETE).write_text("of another version", encoding="utf-8")
    assert not warmed_up.was_warmed_up()
