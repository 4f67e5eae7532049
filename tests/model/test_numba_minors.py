"""The private parts of numba are there in the minor version before the newest, too.

A separate folder holds numba and llvmlite from PyPI. Every shared check runs with them, and the
same samples lead to the same bits as with the numba that is installed.
"""

import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from valvemap.numba_version import TESTED

pytestmark = pytest.mark.minor

ROOT = Path(__file__).parents[2]
INSTALLED = ".".join(version("numba").split(".")[:2])
OTHERS = [minor for minor in TESTED if minor != INSTALLED]
CHECKS = (
    "test_every_estimator.py",
    "test_kernel_cache.py",
    "test_numba_libraries.py",
    "test_numba_unchanged.py::test_numba_is_unchanged_after_an_import_and_a_fit",
    "test_prefetch.py",
)
BITS = """
import numba, numpy as np
from valvemap.model.armax import recursive_maximum_likelihood
from valvemap.model.least_squares_of_arrays import recursive_least_squares

rng = np.random.default_rng(8)
X = rng.normal(size=(300, 4))
y = X @ np.arange(4.0) + rng.normal(size=300)
fit = recursive_least_squares(X, y, forgetting=0.99)
print(numba.__version__)
print(fit.theta_history.tobytes().hex(), fit.covariance.tobytes().hex())
found = recursive_maximum_likelihood(y, X[:, 0], na=1, nb=1, nd=1)
print(found.theta_history.tobytes().hex(), found.covariance.tobytes().hex())
"""


@pytest.fixture(params=OTHERS, scope="module")
def other(request, tmp_path_factory):
    """Environment of a Python that finds another numba first."""
    folder = tmp_path_factory.mktemp("numba")
    numpy = f"numpy=={version('numpy')}"
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    asked = [*pip, "--only-binary", ":all:", "--target", folder, f"numba=={request.param}.*", numpy]
    subprocess.run(asked, check=True, timeout=280)
    paths = os.pathsep.join((str(folder), str(ROOT)))
    return os.environ | {"PYTHONPATH": paths, "NUMBA_CACHE_DIR": str(folder / "cache")}


def bits(environment):
    done = subprocess.run(
        [sys.executable, "-c", BITS],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
        timeout=280,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == "", "no line about a numba that is not tested"
    return done.stdout.splitlines()


def test_the_newest_tested_minor_is_installed():
    assert TESTED[-1] == INSTALLED
    assert OTHERS, "and one before it is tested"


def test_the_same_samples_lead_to_the_same_bits(other):
    (numba, *theirs), (_, *ours) = bits(other), bits(dict(os.environ))
    assert numba.startswith(OTHERS[0])
    assert theirs == ours


@pytest.mark.timeout(1800)
def test_every_shared_check_passes(other):
    files = [str(Path("tests/model") / name) for name in CHECKS]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-m", "not soak", *files],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=other,
        check=False,
        timeout=1800,
    )
    assert done.returncode == 0, done.stdout[-4000:]
    assert " failed" not in done.stdout
