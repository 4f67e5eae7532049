"""What all tests share."""

import gc
import os

# Matrices of tests are small: more threads of BLAS spin, in as many processes as there are. It is
# read when numpy is imported, also by the processes that tests start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import HealthCheck, settings

pytest.register_assert_rewrite(
    "support.interoperation", "support.scada_interoperation", "support.source_interoperation"
)

settings.register_profile(
    "fixed",
    derandomize=True,
    deadline=None,
    max_examples=50,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("fixed")

gc.set_threshold(50_000, 20, 20)  # as in the commands: imports and tests collected are no garbage


@pytest.hookimpl(wrapper=True)
def pytest_collect_file():
    """Look for examples in docstrings of the package alone: tests have none, and are many."""
    return [found for found in (yield) if isinstance(found, pytest.Module)]


def pytest_collection_finish():
    """Leave out of every later collection what stays to the end: a million objects, 0.4 s each."""
    gc.collect()
    gc.freeze()
