"""The systemd unit allows all that the service needs, and little more."""

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from support.processes import free_port, program, run, wait_for
from valvemap.cli import run as valvemap

with_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd")

MOST_EXPOSED = 2.0
"""Of 10, by `systemd-analyze security`; the rest is the network, which the service needs."""


@pytest.fixture
def unit(tmp_path, monkeypatch, capsys):
    """Makes a unit of a configuration with this number of valves."""

    def make(valves=1):
        monkeypatch.chdir(tmp_path)
        nodes = "[valves.nodes]\nU = 's=U'\np1 = 's=1'\np2 = 's=2'\nQ = 's=3'\n"
        text = "".join(f"[[valves]]\nname = 'V{n}'\n{nodes}" for n in range(valves))
        Path("plant.toml").write_text(text, encoding="utf-8")
        assert valvemap(["unit", "--config", "plant.toml", "--user", "root"]) == 0
        return capsys.readouterr().out

    return make


def settings(text):
    found = {}
    for name, value in re.findall(r"^(\w+)=(.*)$", text, re.MULTILINE):
        found.setdefault(name, []).append(value)
    return found


def test_the_manager_waits_for_ready_and_restarts_a_service_that_is_silent(unit):
    found = settings(unit())
    assert found["Type"] == ["notify"]
    assert int(found["WatchdogSec"][0]) > 0
    assert int(found["TimeoutStartSec"][0]) > int(found["WatchdogSec"][0])
    assert found["Restart"] == ["on-failure"]
    assert found["ExecReload"] == ["/bin/kill -HUP $MAINPID"]


def test_the_service_has_no_capability_and_the_calls_of_a_service(unit):
    found = settings(unit())
    assert found["CapabilityBoundingSet"] == [""]
    assert found["AmbientCapabilities"] == [""]
    assert found["SystemCallFilter"] == ["@system-service", "~@privileged"]


def test_memory_is_bounded_by_the_number_of_valves(unit):
    def mib(n):
        return int(settings(unit(n))["MemoryMax"][0].removesuffix("M"))

    assert mib(201) - mib(101) == mib(101) - mib(1) == 100
    assert 512 < mib(1) < 4096


@with_systemd
def test_systemd_understands_every_line(unit, tmp_path):
    file = tmp_path / "valvemap.service"
    file.write_text(unit(), encoding="utf-8")
    done = subprocess.run(
        ["systemd-analyze", "verify", file], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


@with_systemd
def test_little_of_the_machine_is_exposed(unit, tmp_path):
    file = tmp_path / "valvemap.service"
    file.write_text(unit(), encoding="utf-8")
    asked = ["systemd-analyze", "security", "--offline=true", "--no-pager", file]
    text = subprocess.run(asked, capture_output=True, text=True, check=True).stdout
    assert float(re.search(r"exposure level for \S+: ([\d.]+)", text)[1]) <= MOST_EXPOSED


def calls_of(group, known={}):  # noqa: B006 - a cache
    """System calls of a group of systemd's."""
    if group not in known:
        asked = ["systemd-analyze", "syscall-filter", "--no-pager", group]
        lines = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split("\n")
        names = {line.strip() for line in lines[1:]} - {""}
        names = {name for name in names if not name.startswith("#")}
        groups = {name for name in names if name.startswith("@")}
        known[group] = (names - groups).union(*map(calls_of, groups))
    return known[group]


@with_systemd
@pytest.mark.waits
@pytest.mark.skipif(shutil.which("strace") is None, reason="no strace")
def test_the_service_makes_no_call_that_its_unit_forbids(unit, tmp_path):
    """From its start, with a source that is away, to its end."""
    allowed = set()
    for group in settings(unit())["SystemCallFilter"]:
        calls = calls_of(group.removeprefix("~"))
        allowed = allowed - calls if group.startswith("~") else allowed | calls
    assert {"read", "mmap", "sendto"} <= allowed
    assert {"chown", "mount", "bpf", "setuid"} & allowed == set()

    data, log, trace = tmp_path / "data", tmp_path / "log", tmp_path / "trace"
    assert run("init", "--data", str(data)).returncode == 0
    text = (data / "service.toml").read_text(encoding="utf-8")
    text = text.replace(":4840", f":{free_port()}").replace(":4841", f":{free_port()}")
    text = text.replace("publishing_interval_ms", "startup_timeout_s = 0\npublishing_interval_ms")
    (data / "service.toml").write_text(text, encoding="utf-8")
    traced = ["strace", "-f", "-qq", "-c", "-U", "name", "-o", trace]  # counts alone: no arguments
    command = [sys.executable, "-m", "valvemap", "serve", "--config", data / "service.toml"]
    with program(*traced, *command, log=log) as process:
        wait_for(log, "waiting for the source", process, timeout=200.0)
        (main,) = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        subprocess.run(["kill", f"-{signal.SIGINT.value}", main], check=True)
        assert process.wait(60) == 0
    made = set(re.findall(r"^(\w+)$", trace.read_text(), re.MULTILINE)) - {"syscall", "total"}
    assert {"socket", "bind", "openat"} <= made
    of_root = {"fchown"} if os.geteuid() == 0 else set()  # SQLite's, which ignores its failure
    assert made - allowed - of_root == set()
