"""A command in a fork and in a new Python: equal output, code, environment, signals, files."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from support.command_forks import can_fork
from support.processes import free_port, rig_url, run, running, wait_for

pytestmark = [
    pytest.mark.waits,
    pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="Linux forks"),
]


def files_of(process):
    return {str(one.readlink()) for one in Path(f"/proc/{process.pid}/fd").iterdir()}


def in_a_new_python(*arguments):
    command = [sys.executable, "-m", "valvemap", *arguments]
    return subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=False)


@pytest.fixture
def rig(tmp_path):
    """A rig that runs; its process and its log."""
    log = tmp_path / "rig.log"
    command = ["rig", "--under-demo", "--url", rig_url(free_port())]
    with running(*command, stdin="password\n", log=log) as process:
        wait_for(log, "opc.tcp://", process)
        yield process, log


@pytest.mark.parametrize(
    "arguments",
    [["--version"], ["trust", "unknown"], ["check-config", "räum.toml"]],
)
def test_it_prints_and_returns_the_same(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "räum.toml").write_text("valves = 7", encoding="utf-8")
    fork, new = run(*arguments), in_a_new_python(*arguments)
    assert (fork.returncode, fork.stdout, fork.stderr) == (new.returncode, new.stdout, new.stderr)


def test_its_folder_and_its_environment_are_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("init", env={"VALVEMAP_DATA": "of-one"}).returncode == 0
    monkeypatch.setenv("VALVEMAP_DATA", "of-all")
    assert run("init").returncode == 0
    monkeypatch.delenv("VALVEMAP_DATA")
    assert run("init", "--data", "none").returncode == 0
    assert {found.name for found in tmp_path.iterdir()} == {"of-one", "of-all", "none"}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_in_order(rig, number):
    process, log = rig
    assert process.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.05)
    process.send_signal(number)
    assert process.wait(30) == 0, log.read_text()


def test_one_that_is_killed_says_so(rig):
    process, _ = rig
    process.kill()
    assert process.wait(30) == -signal.SIGKILL
    process.send_signal(signal.SIGINT)  # no other process gets it


def test_it_holds_no_file_of_another(rig, tmp_path):
    first, _ = rig
    log = tmp_path / "second.log"
    command = ["rig", "--under-demo", "--url", rig_url(free_port())]
    with running(*command, stdin="password\n", log=log) as second:
        wait_for(log, "opc.tcp://", second)
        of_first, held = map(files_of, (first, second))
    shared = {one for one in held & of_first if one.startswith(("pipe:", "socket:", "/proc"))}
    assert shared == set()
    assert str(log) in held
    assert len([one for one in held if one.startswith("pipe:")]) == 1  # its standard input


def test_what_is_read_at_the_start_of_python_needs_a_new_one():
    assert can_fork({**os.environ, "VALVEMAP_DATA": "data"})
    assert not can_fork({**os.environ, "NUMBA_CACHE_DIR": "cache"})
    assert not can_fork({**os.environ, "PYTHONUTF8": "1"})
