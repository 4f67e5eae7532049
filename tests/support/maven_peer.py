"""Programs in Java, built once as their pom says: Eclipse Milo, Eclipse Tahu."""

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from support.building import building


def program(folder: Path, main: str, cache: Path) -> tuple[str, ...]:
    """Return the command of a folder's main class; skip the test where it cannot be built."""
    maven, java = shutil.which("mvn"), shutil.which("java")
    if maven is None or java is None:
        pytest.skip("mvn and java are not installed")
    sources = sorted(path for path in folder.rglob("*") if path.is_file())
    content = b"".join(path.read_bytes() for path in sources)
    built = cache / hashlib.sha256(content).hexdigest()[:16]
    with building(cache):
        if not (built / "ready").exists():
            _build(maven, folder, built)
    target = built / "target"
    return (
        java,
        "-cp",
        os.pathsep.join([f"{target / 'classes'}", f"{target / 'lib'}{os.sep}*"]),
        main,
    )


def _build(maven: str, folder: Path, built: Path) -> None:
    shutil.rmtree(built, ignore_errors=True)
    shutil.copytree(folder, built)
    command = [maven, "--quiet", "--batch-mode", "compile"]
    try:
        done = subprocess.run(
            command, cwd=built, capture_output=True, text=True, timeout=240, check=False
        )
    except subprocess.TimeoutExpired:
        pytest.skip("mvn compile took longer than 240 s")
    if "COMPILATION ERROR" in done.stdout:
        pytest.fail(done.stdout)
    if done.returncode:
        pytest.skip(f"mvn compile failed: {done.stdout.strip()[-300:]}")
    (built / "ready").touch()
