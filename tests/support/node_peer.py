"""node-opcua, installed once as its lock file says."""

import hashlib
import shutil
import subprocess
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "opcua" / "node_peer"
_PACKAGE = ("package.json", "package-lock.json")


def program(cache: Path, script: str) -> tuple[str, Path]:
    """Return the command of a script; skip the test where node-opcua cannot be had."""
    npm, node = shutil.which("npm"), shutil.which("node")
    if npm is None or node is None:
        pytest.skip("node and npm are not installed")
    content = b"".join((FOLDER / name).read_bytes() for name in _PACKAGE)
    target = cache / hashlib.sha256(content).hexdigest()[:16]
    if not (target / "ready").exists():
        _install(npm, target)
    shutil.copy(FOLDER / script, target)
    return node, target / script


def _install(npm: str, target: Path) -> None:
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    for name in _PACKAGE:
        shutil.copy(FOLDER / name, target)
    command = [npm, "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--loglevel=error"]
    try:
        done = subprocess.run(
            command, cwd=target, capture_output=True, text=True, timeout=240, check=False
        )
    except subprocess.TimeoutExpired:
        pytest.skip("npm ci took longer than 240 s")
    if done.returncode:
        pytest.skip(f"npm ci failed: {done.stderr.strip()[-300:]}")
    (target / "ready").touch()
