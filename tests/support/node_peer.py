"""Packages of npm, installed once as their lock files say: node-opcua, axe-core, Node-RED, FUXA."""

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from support.building import building

FOLDER = Path(__file__).parents[1] / "opcua" / "node_peer"
_PACKAGE = ("package.json", "package-lock.json")
_INSTALL_S = 240.0


def program(cache: Path, script: str) -> tuple[str, Path]:
    """Return the command of a script; skip the test where node-opcua cannot be had."""
    target = installed(FOLDER, cache)
    new = target / f"{os.getpid()}.{script}"
    shutil.copy(FOLDER / script, new)
    new.replace(target / script)  # at once: another process may start it
    return shutil.which("node"), target / script


def installed(folder: Path, cache: Path) -> Path:
    """Install what a folder's lock file says; skip the test where that cannot be had."""
    npm = shutil.which("npm")
    if npm is None or shutil.which("node") is None:
        pytest.skip("node and npm are not installed")
    content = b"".join((folder / name).read_bytes() for name in _PACKAGE)
    target = cache / hashlib.sha256(content).hexdigest()[:16]
    with building(cache):
        if not (target / "ready").exists():
            _install(npm, folder, target)
    return target


def _install(npm: str, folder: Path, target: Path) -> None:
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    for name in _PACKAGE:
        shutil.copy(folder / name, target)
    command = [npm, "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--loglevel=error"]
    try:
        done = subprocess.run(
            command, cwd=target, capture_output=True, text=True, timeout=_INSTALL_S, check=False
        )
    except subprocess.TimeoutExpired:
        pytest.skip(f"npm ci took longer than {_INSTALL_S:.0f} s")
    if done.returncode:
        pytest.skip(f"npm ci failed: {done.stderr.strip()[-300:]}")
    (target / "ready").touch()
