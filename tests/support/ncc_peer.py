"""open62541's NodeSet compiler (o6-ncc), a program of its own, installed once."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from support.building import building

FOLDER = Path(__file__).parents[1] / "opcua" / "ncc_peer"


def installed(cache):
    """Where it is, in a folder that is kept; skip the test where it cannot be had."""
    target = cache.mkdir("ncc_peer")
    with building(target):
        if not (target / "o6_nodeset_compiler").exists():
            command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps"]
            command += ["--require-hashes", "--target", target, "-r", FOLDER / "requirements.txt"]
            done = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
            if done.returncode:
                pytest.skip(f"o6-ncc cannot be had: {done.stderr.strip()[-300:]}")
    return target


def said(compiler, script, *arguments):
    """The last line that a script of ours says which uses it."""
    command = [sys.executable, FOLDER / script, *arguments]
    environment = {**os.environ, "PYTHONPATH": str(compiler)}
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=800, check=False, env=environment
    )
    assert done.returncode == 0, done.stderr[-2_000:]
    return done.stdout.splitlines()[-1]
