"""The page process stays small: what it does not need it does not load."""

import subprocess
import sys

PROGRAM = """
import sys, service.app.dashboard, service.cli.dashboard
heavy = {"numba", "scipy", "pandas", "matplotlib", "pydantic", "service.identification"}
print(*sorted(heavy & set(sys.modules)))
"""


def test_the_page_loads_no_kernels_and_no_configuration():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.split() == []
