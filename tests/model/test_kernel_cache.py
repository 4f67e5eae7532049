"""A kernel that was compiled before is run again for as long as all that is behind it stays."""

import os
import shutil
from pathlib import Path

import pytest

from support.compiler_forks import forks

ROOT = Path(__file__).parents[2]
FILES = {
    "__init__.py": "",
    "kernels.py": """
from valvemap.model.kernels.compiled import inner, kernel
from PACKAGE.inner import scaled
from PACKAGE import limits

@kernel
def judged(x):
    return scaled(x) + limits.LOWEST

@kernel
def alone(x):
    return 2.0 * x
""",
    "inner.py": """
from valvemap.model.kernels.compiled import inlined, inner, spliced
from PACKAGE.rules import FACTOR

@inner
def scaled(x):
    return FACTOR * doubled(x) + written(x)

@inlined
def doubled(x):
    return 2.0 * x

@spliced
def written(x):
    return 0.0 * x
""",
    "rules.py": "FACTOR = 3.0\n",
    "limits.py": "LOWEST = 1.0\n",
}
RUN = """
from {package} import kernels
print(kernels.judged(2.0))
print(sum(kernels.judged.stats.cache_hits.values()))
"""


def written(folder):
    folder.mkdir(parents=True)
    for name, text in FILES.items():
        (folder / name).write_text(text.replace("PACKAGE", "minikernels"))
    return folder


@pytest.fixture(scope="module")
def run():
    """Run a package's kernel in a process of its own; return its value and the cache's hits."""
    with forks() as processes:

        def of(package, cache=None):
            paths = os.pathsep.join((str(package.parent), str(ROOT)))
            environment = os.environ | {"PYTHONPATH": paths}
            environment["PYTHONDONTWRITEBYTECODE"] = "1"  # bytecode is known by the second alone
            environment.pop("NUMBA_CACHE_DIR", None)
            if cache is not None:
                environment["NUMBA_CACHE_DIR"] = str(cache)
            done = processes.run(RUN.format(package=package.name), environment)
            assert done.returncode == 0, done.stderr
            value, hits = done.stdout.split()
            return float(value), int(hits)

        yield of


@pytest.fixture(scope="module")
def compiled(run, tmp_path_factory):
    """A package whose kernels were compiled by a first process and loaded by a second."""
    folder = written(tmp_path_factory.mktemp("compiled") / "minikernels")
    assert run(folder) == (13.0, 0)
    assert run(folder) == (13.0, 1)
    return folder


@pytest.fixture
def package(compiled, tmp_path):
    """A copy of it; that a cache is good at another path is a test of its own."""
    return shutil.copytree(compiled, tmp_path / "first" / "minikernels")


@pytest.mark.parametrize(
    ("file", "old", "new", "value"),
    [
        ("rules.py", "3.0", "5.0", 21.0),  # a constant behind a function behind another module
        ("limits.py", "1.0", "2.0", 14.0),
        ("inner.py", "2.0 * x", "3.0 * x", 19.0),
        ("inner.py", "0.0 * x", "1.0 * x", 15.0),
        ("kernels.py", "+ limits", "- limits", 11.0),
    ],
)
def test_changed_code_is_run_at_once(run, package, file, old, new, value):
    text = (package / file).read_text()
    assert text.count(old) == 1 or file == "inner.py"
    (package / file).write_text(text.replace(old, new, 1))
    assert run(package) == (value, 0)


def test_changed_code_is_compiled_once(run, package):
    (package / "rules.py").write_text("FACTOR = 4.0\n")
    assert run(package) == (17.0, 0)
    assert run(package) == (17.0, 1)


def test_a_comment_compiles_nothing_and_a_change_elsewhere_neither(run, package):
    for file in FILES:
        text = (package / file).read_text()
        (package / file).write_text(f"# A comment.\n\n{text}\n# Another one.\n")
    assert run(package) == (13.0, 1)
    (package / "apart.py").write_text("X = 1\n")
    os.utime(package / "kernels.py", (0, 0))
    assert run(package) == (13.0, 1)


def test_what_was_compiled_before_a_change_is_removed(run, package):
    cached = package / "__pycache__"
    before = {file.name for file in cached.glob("kernels.judged*")}
    (package / "rules.py").write_text("FACTOR = 4.0\n")
    run(package)
    after = {file.name for file in cached.glob("kernels.judged*")}
    assert len(before) == len(after) == 2
    assert before & after == set()


def test_a_process_that_was_killed_between_index_and_code_leaves_no_old_code(run, package):
    """Numba writes a kernel's index first: the code that it names must not be of another stamp."""
    cached = package / "__pycache__"
    old = {file.name: file.read_bytes() for file in cached.glob("*.nbc")}
    (package / "rules.py").write_text("FACTOR = 4.0\n")
    run(package)
    for file in cached.glob("*.nbc"):
        file.unlink()
    for name, code in old.items():
        (cached / name).write_bytes(code)
    assert run(package) == (17.0, 0)


def test_a_cache_is_good_at_another_path(run, compiled, tmp_path):
    moved = tmp_path / "elsewhere" / compiled.name
    shutil.copytree(compiled, moved)
    for file in moved.glob("*.py"):
        os.utime(file, (1e9, 1e9))
    assert run(moved) == (13.0, 1)


def test_the_cache_folder_of_the_environment_is_used(run, tmp_path):
    package = written(tmp_path / "minikernels")
    assert run(package, tmp_path / "kept") == (13.0, 0)
    assert run(package, tmp_path / "kept") == (13.0, 1)
    assert not list(package.rglob("*.nbi"))
