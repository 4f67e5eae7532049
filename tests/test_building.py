"""Foreign programs are built once, however many processes of pytest need them."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("fcntl")

BUILDS = """
import sys, time
from pathlib import Path
from support.building import building

folder = Path(sys.argv[1])
with building(folder):
    if not (folder / "ready").exists():
        with (folder / "builds").open("a") as builds:
            builds.write("x")
        time.sleep(0.2)
        (folder / "ready").touch()
"""


def test_processes_that_need_the_same_program_build_it_once(tmp_path):
    tests = Path(__file__).parent
    asked = [sys.executable, "-c", BUILDS, str(tmp_path / "built")]
    several = [subprocess.Popen(asked, cwd=tests) for _ in range(4)]
    assert [one.wait(60) for one in several] == [0] * 4
    assert (tmp_path / "built" / "builds").read_text() == "x"
