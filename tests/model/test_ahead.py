"""Kernels that came with a wheel are run where they fit, and only there."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.compiler_forks import forks, without_numba
from valvemap.model.kernels import ahead

ROOT = Path(__file__).parents[2]
EVERY = dict.fromkeys(ahead._V3.split(), True)
OF_A_TEST = """
from valvemap.model.kernels.compiled import inner, kernel

@inner
def tripled(x):
    return 3.0 * x

@kernel
def one_more(x):
    return tripled(x) + 1.0

@kernel
def twice(x):
    return 2.0 * one_more(x)
"""
RUN = """
import json, sys
from pathlib import Path
from valvemap.model.kernels import ahead
folder, called = sys.argv[1], sys.argv[2:]
ahead.HOME = Path(folder)
ahead.folder.cache_clear()
import kernels_of_a_test as k
kernels = [getattr(k, name) for name in called]
print(json.dumps([[one(2.0), sum(one.stats.cache_hits.values())] for one in kernels]))
"""
PLACE = "from valvemap.model.kernels import ahead; print(ahead.place(ahead.kind_of_machine()))"
PACK = """
import sys; from pathlib import Path
from valvemap.model.kernels import compiled, packing
print(packing.pack(Path(sys.argv[1])))
"""
V3 = {"NUMBA_CPU_NAME": "x86-64-v3", "NUMBA_CPU_FEATURES": ""}
GENERIC = {"NUMBA_CPU_NAME": "generic"}


@pytest.fixture(scope="module")
def python():
    """Run code as a new process of a generic machine, or of any other, and return what it says."""
    with forks(**GENERIC) as generic:

        def ran(code, *arguments, **environment):
            given = without_numba() | environment
            if GENERIC.items() <= environment.items():
                done = generic.run(code, given, *arguments)
            else:
                asked = [sys.executable, "-c", code, *arguments]
                done = subprocess.run(
                    asked, capture_output=True, text=True, env=given, check=False, timeout=120
                )
            assert done.returncode == 0, done.stderr
            return done.stdout.strip()

        yield ran


@pytest.fixture(scope="module")
def shipped(python, tmp_path_factory):
    """A module's kernels, compiled for generic machines as a wheel's are; paths of both."""
    home = tmp_path_factory.mktemp("home")
    code = home / "code"
    code.mkdir()
    (code / "kernels_of_a_test.py").write_text(OF_A_TEST)
    place = python(PLACE, PYTHONPATH=str(ROOT), **GENERIC)
    assert place.endswith("/generic")
    into = home / "ahead" / place
    into.mkdir(parents=True)
    paths = os.pathsep.join((str(ROOT), str(code)))
    call = "import kernels_of_a_test as k; k.one_more(2.0)"
    python(call, PYTHONPATH=paths, VALVEMAP_COMPILE_INTO=str(into), **GENERIC)
    packed = python(PACK, str(into), PYTHONPATH=paths, **GENERIC)
    assert packed == "1"  # the inner function is left out
    assert not list(code.rglob("*.nbi"))
    return home / "ahead", code


@pytest.fixture
def run(python, shipped, tmp_path):
    """Call kernels of the module in a process; of each the value and the hits of its cache."""

    def called(*names, code=None, **environment):
        home, shipped_code = shipped
        environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")} | environment
        paths = os.pathsep.join((str(ROOT), str(code or shipped_code)))
        return json.loads(python(RUN, str(home), *names, PYTHONPATH=paths, **environment))

    return called


def test_a_kernel_that_came_compiled_is_not_compiled(run, tmp_path):
    assert run("one_more", **GENERIC) == [[7.0, 1]]
    assert not list((tmp_path / "cache").rglob("*.nbc"))


def test_it_is_linked_into_one_that_did_not(run):
    assert run("one_more", "twice", **GENERIC) == [[7.0, 1], [14.0, 0]]
    assert run("twice", "one_more", **GENERIC) == [[14.0, 1], [7.0, 1]]


def test_a_better_machine_compiles_where_only_its_own_kind_would_do(run):
    assert run("one_more", **V3) == [[7.0, 0]]
    assert run("one_more", **V3) == [[7.0, 1]]


def test_changed_code_is_compiled(run, shipped, tmp_path):
    _, code = shipped
    moved = tmp_path / "code"
    shutil.copytree(code, moved)
    file = moved / "kernels_of_a_test.py"
    file.write_text("# A comment.\n" + file.read_text())
    assert run("one_more", code=moved, **GENERIC) == [[7.0, 1]]
    file.write_text(file.read_text().replace("3.0 * x", "4.00 * x"))  # another size: no stale .pyc
    assert run("one_more", code=moved, **GENERIC) == [[9.0, 0]]


@pytest.mark.parametrize(
    ("present", "name", "features", "kind"),
    [
        (EVERY, None, None, "x86-64-v3"),
        (EVERY | {"avx512f": True}, None, None, "x86-64-v3"),
        (EVERY | {"fma": False}, None, None, "generic"),
        ({}, None, None, "generic"),
        (EVERY, "generic", "", "generic"),
        (EVERY, "x86-64-v3", "", "x86-64-v3"),
        (EVERY, "znver4", None, None),
        (EVERY, None, "+avx", None),
        (EVERY, "x86-64-v3", "+avx512f", None),
    ],
)
def test_the_best_kind_that_runs_here_is_chosen(monkeypatch, present, name, features, kind):
    monkeypatch.setattr(ahead.binding, "get_host_cpu_features", lambda: present)
    monkeypatch.setattr(ahead.config, "CPU_NAME", name)
    monkeypatch.setattr(ahead.config, "CPU_FEATURES", features)
    assert ahead.kind_of_machine() == kind


def test_another_python_numba_or_platform_looks_elsewhere(monkeypatch):
    here = ahead.place("generic")
    monkeypatch.setattr(ahead, "version", lambda _: "0.1.0")
    assert ahead.place("generic") != here
    monkeypatch.undo()
    monkeypatch.setattr(ahead.sysconfig, "get_platform", lambda: "linux-aarch64")
    assert ahead.place("generic") != here
