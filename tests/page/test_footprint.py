"""The page process stays small: what it does not need it does not load."""

import subprocess
import sys

import pytest

from benchmarks import page

PROGRAM = """
import sys, valvemap.app.dashboard, valvemap.cli.dashboard
heavy = {"numba", "scipy", "pandas", "matplotlib", "pydantic", "valvemap.model"}
print(*sorted(heavy & set(sys.modules)))
"""


def test_the_page_loads_no_kernels_and_no_configuration():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.split() == []


@pytest.mark.soak  # six minutes, and figures of the machine
@pytest.mark.timeout(1_200)
def test_the_page_is_small_and_the_service_does_not_feel_it():
    found = page.figures()
    assert found["page above a bare asyncua import, MB"] <= 80.0
    assert found["page, % of a core, with 1 viewers"] <= 15.0
    assert found["service, 20 viewers against none, %"] <= 5.0
    assert found["samples lost"] == 0.0
