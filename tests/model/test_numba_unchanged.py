"""Importing valvemap changes nothing of numba; a command may, and results stay as they are."""

import os
from functools import cache

import pytest

from support.compiler_forks import forks, without_numba

# Every function, method and class attribute of numba and of llvmlite's binding, by identity.
PARTS = """
import importlib, inspect, pkgutil, sys

def parts():
    found = {}
    for name, module in list(sys.modules.items()):
        if name.split(".")[0] not in ("numba", "llvmlite") or module is None:
            continue
        for key, value in list(vars(module).items()):
            if key.startswith("__"):
                continue
            if inspect.isfunction(value) or inspect.isclass(value):
                found[name, key] = id(value)
            if inspect.isclass(value) and value.__module__.split(".")[0] in ("numba", "llvmlite"):
                for inner, member in list(vars(value).items()):
                    if inner in ("__doc__", "__abstractmethods__", "_abc_impl", "__weakref__"):
                        continue
                    member = getattr(member, "__func__", member)
                    if callable(member) or inner in ("__eq__", "__hash__"):
                        found[f"{value.__module__}.{value.__qualname__}", inner] = id(member)
    return found

import numba, numpy as np
import numba.core.codegen, numba.core.targetconfig, numba.np.linalg, numba.np.arraymath
from llvmlite.binding import ffi

@numba.njit
def of_a_notebook(x):
    return x.sum() + x[0] * 2

of_a_notebook(np.ones(3))  # numba loads the rest of itself
before, listening = parts(), list(ffi.lib._lock._cblist)
"""
FIT = """
import valvemap
X = np.random.default_rng(3).normal(size=(200, 4))
fit = valvemap.recursive_least_squares(X, X @ np.arange(4.0) + 0.1)
after = parts()
changed = sorted(str(key) for key in before if after.get(key) != before[key])
assert not changed, changed
assert list(ffi.lib._lock._cblist) == listening
"""
BITS = """
import sys
import numpy as np
if "ask" in sys.argv:
    from valvemap.numba_version import ask_for_shortcuts
    ask_for_shortcuts()
import valvemap
from numba.core.targetconfig import TargetConfig
X = np.random.default_rng(3).normal(size=(500, 4))
y = X @ np.arange(4.0) + 0.1 * np.sin(np.arange(500))
if "kinds" in sys.argv:
    from kernels_of_every_kind import swept
    found = swept(X, y)
elif "likelihood" in sys.argv:
    fit = valvemap.recursive_maximum_likelihood(y, X[:, 0], 1, 2, 1)
    found = fit.theta_history, fit.covariance
else:
    fit = valvemap.recursive_least_squares(X, y, forgetting=0.99)
    found = fit.theta_history, fit.covariance
print(TargetConfig.__eq__.__module__)
print(*(array.tobytes().hex() for array in found))
"""
KINDS = """
import numpy as np
from valvemap.model.kernels.compiled import inlined, inner, kernel, lean_kernel, maker, spliced

@inner
def scaled(x, y):
    return x * y / (1.0 + abs(x))

@inlined
def bent(x):
    return x + np.sqrt(abs(x)) - np.exp(-abs(x))

@spliced
def either(x, rising):
    return bent(x) if rising else -bent(x)

@maker
def columns(X):
    sums = np.zeros(X.shape[1])
    for i in range(X.shape[0]):
        for j in range(X.shape[1]):
            sums[j] += scaled(X[i, j], sums[j - 1])
    return sums

@lean_kernel
def lean(parts, y, into):
    X, sums = parts
    total = 0.0
    for i in range(len(y)):
        total = 0.99 * total + either(X[i, i % X.shape[1]] - y[i], i % 3 == 0) / (1.0 + total**2)
        into[i] = total + sums[i % len(sums)]
    return total

@kernel
def means(X):
    return columns(X) / X.shape[0]

def swept(X, y):
    into, sums = np.zeros(len(y)), means(X)
    lean((X, sums), y, into)
    return sums, into
"""


@pytest.fixture(scope="module")
def kinds(tmp_path_factory):
    """Environment in which a module has kernels of every kind."""
    folder = tmp_path_factory.mktemp("kinds")
    (folder / "kernels_of_every_kind.py").write_text(KINDS)
    paths = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {"PYTHONPATH": os.pathsep.join(paths)}


@pytest.fixture(scope="module")
def asked(run, kinds, tmp_path_factory):
    """What each fit prints with shortcuts, and an empty cache."""
    return cache(
        lambda fitted: run(
            BITS, fitted, "ask", **kinds, NUMBA_CACHE_DIR=str(tmp_path_factory.mktemp("asked"))
        )
    )


@pytest.fixture(scope="module")
def run():
    """Run code in a process that has imported numba, and nothing of valvemap."""
    with forks() as processes:
        yield lambda source, *arguments, **environment: processes.run(
            source, without_numba() | environment, *arguments
        )


def test_numba_is_unchanged_after_an_import_and_a_fit(run):
    done = run(PARTS + FIT)
    assert done.returncode == 0, done.stderr


def test_the_check_sees_what_a_command_changes(run):
    """Otherwise it would not see what an import changes either."""
    asked = "from valvemap.numba_version import ask_for_shortcuts\nask_for_shortcuts()\n"
    done = run(PARTS + asked + FIT)
    assert done.returncode == 1
    for part in ("TargetConfig', '__eq__", "BaseFunction', 'get_call_type"):
        assert part in done.stderr


SLOW = pytest.param("likelihood", marks=pytest.mark.minor)  # compiles for half a minute


@pytest.mark.parametrize("fitted", ["kinds", SLOW, pytest.param("squares", marks=pytest.mark.soak)])
def test_results_have_the_same_bits_with_and_without_shortcuts(run, fitted, kinds, asked, tmp_path):
    same_bits(run(BITS, fitted, **kinds, NUMBA_CACHE_DIR=str(tmp_path)), asked(fitted))


def test_a_cached_fit_has_the_same_bits_with_and_without_shortcuts(run):
    same_bits(run(BITS, "squares"), run(BITS, "squares", "ask"))


def same_bits(plain, quick):
    assert plain.returncode == quick.returncode == 0, plain.stderr + quick.stderr
    (theirs, bits), (ours, same) = plain.stdout.split("\n", 1), quick.stdout.split("\n", 1)
    assert theirs.startswith("numba.")
    assert ours.startswith("valvemap.")
    assert len(bits) > 1_000
    assert bits == same


@pytest.mark.parametrize("fitted", ["kinds", SLOW])
def test_an_unknown_numba_is_left_to_itself_and_one_line_says_so(run, fitted, kinds, asked):
    unknown = "import valvemap.numba_version as v; v.TESTED = ('0.1', '0.2')\n"
    kernels = "from valvemap.model.kernels import plain_numba, rules\n"
    private = "import sys; assert not any(m.endswith('.tested_numba') for m in sys.modules)\n"
    plain = asked(fitted)
    other = run(unknown + BITS + kernels + private, fitted, "ask", **kinds)
    assert other.returncode == 0, other.stderr
    assert other.stdout.split("\n", 1)[1] == plain.stdout.split("\n", 1)[1]
    assert other.stdout.startswith("numba.")
    assert len(other.stderr.splitlines()) == 1, other.stderr
    assert "is none of the tested 0.1, 0.2" in other.stderr
