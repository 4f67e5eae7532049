"""What all tests share."""

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


@pytest.hookimpl(wrapper=True)
def pytest_collect_file():
    """Look for examples in docstrings of the package alone: tests have none, and are many."""
    return [found for found in (yield) if isinstance(found, pytest.Module)]
