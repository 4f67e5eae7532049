"""Pipeline and storage killed hundreds of times: at the end the bits of one life."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from support import forks

ROOT = Path(__file__).parents[2]


@pytest.mark.skipif(sys.platform == "win32", reason="fork")
@pytest.mark.parametrize(
    "kills", [5, pytest.param(950, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])]
)
def test_killed_at_any_moment_nothing_is_lost_twice_or_different(kills, tmp_path):
    command = [sys.executable, forks.__file__, str(kills), "1", str(tmp_path / "state.sqlite")]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(("tests", "."))},
    )
    outcome = json.loads(done.stdout)
    assert outcome.pop("samples") > 100
    assert outcome == {"lost": 0, "twice": 0, "different": 0, "unreadable": 0}, done.stderr
