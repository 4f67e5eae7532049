"""Limits on file descriptors: raised where that is allowed, else named at the start."""

import subprocess
import sys

import pytest

from support.processes import free_port, service_url
from support.soaked import soaked
from valvemap.cli import run

resource = pytest.importorskip("resource")

SERVE = """
import resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (int(sys.argv[1]),) * 2)
from valvemap.cli import run
sys.exit(run(["serve", "--config", sys.argv[2]]))
"""
IN_LITTLE_MEMORY = """
import resource, sys
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]) << 20,) * 2)
from valvemap.cli import run
sys.exit(run(["serve", "--config", "missing.toml"]))
"""
RAISE = """
import resource
from valvemap.app.limits import allow_descriptors
resource.setrlimit(resource.RLIMIT_NOFILE, (50, 400))
allow_descriptors(40)
print(resource.getrlimit(resource.RLIMIT_NOFILE))
allow_descriptors(300)
print(resource.getrlimit(resource.RLIMIT_NOFILE))
"""


def python(code, *arguments, env=None):
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=env)


def test_the_soft_limit_is_raised_when_it_is_too_low():
    assert python(RAISE).stdout.splitlines() == ["(50, 400)", "(400, 400)"]


@pytest.mark.parametrize("limit", [40, *soaked(64)])
def test_a_service_with_too_few_descriptors_is_refused_in_one_line(limit, tmp_path, monkeypatch):
    data = tmp_path / "data"
    monkeypatch.setenv("VALVEMAP_OPERATOR_PASSWORD", "a long enough password")
    monkeypatch.setenv("VALVEMAP_SERVER__URL", service_url(free_port()))
    assert run(["init", "--data", str(data)]) == 0
    done = python(SERVE, str(limit), str(data / "service.toml"))
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    said = f"valvemap: {limit} file descriptors are allowed, 166 are needed; raise the limit"
    assert line.startswith(said)


@pytest.mark.parametrize("limit", [300, 600])
def test_a_service_with_too_little_address_space_is_refused_in_one_line(limit):
    done = python(IN_LITTLE_MEMORY, str(limit))
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    said = f"valvemap: {limit} MB of address space are allowed, 1,000 are needed; raise the limit"
    assert line.startswith(said)
