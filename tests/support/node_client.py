"""node-opcua as a client of another stack: installs it once, runs plans with it."""

import asyncio
import hashlib
import json
import shutil
import subprocess
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "opcua" / "node_client"
_PACKAGE = ("package.json", "package-lock.json")
_SCRIPT = "client.cjs"


def install(cache: Path) -> Path:
    """Install what the lock file says into the cache; skip the test where that cannot be."""
    npm, node = shutil.which("npm"), shutil.which("node")
    if npm is None or node is None:
        pytest.skip("node and npm are not installed")
    content = b"".join((FOLDER / name).read_bytes() for name in _PACKAGE)
    target = cache / hashlib.sha256(content).hexdigest()[:16]
    if not (target / "ready").exists():
        _install(npm, target)
    shutil.copy(FOLDER / _SCRIPT, target)
    return target


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


async def run_plan(folder: Path, plan: dict) -> dict:
    """Run a plan (see client.cjs) and return what it found, or its error."""
    process = await asyncio.create_subprocess_exec(
        shutil.which("node") or "node",
        str(folder / _SCRIPT),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        async with asyncio.timeout(60):
            out, err = await process.communicate(json.dumps(plan).encode())
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    start = out.rfind(b'{"results"') if b'{"results"' in out else out.rfind(b'{"error"')
    assert start >= 0, f"node said {out.decode()!r} and {err.decode()!r}"
    return json.loads(out[start:])
