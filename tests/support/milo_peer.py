"""Eclipse Milo, built once as its pom says."""

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "opcua" / "milo_client"


def program(cache: Path) -> tuple[str, ...]:
    """Return the command of the client; skip the test where it cannot be built."""
    maven, java = shutil.which("mvn"), shutil.which("java")
    if maven is None or java is None:
        pytest.skip("mvn and java are not installed")
    sources = sorted(path for path in FOLDER.rglob("*") if path.is_file())
    content = b"".join(path.read_bytes() for path in sources)
    built = cache / hashlib.sha256(content).hexdigest()[:16]
    if not (built / "ready").exists():
        _build(maven, built)
    target = built / "target"
    return (
        java,
        "-cp",
        os.pathsep.join([f"{target / 'classes'}", f"{target / 'lib'}{os.sep}*"]),
        "valvemap.Client",
    )


def _build(maven: str, built: Path) -> None:
    shutil.rmtree(built, ignore_errors=True)
    shutil.copytree(FOLDER, built)
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
