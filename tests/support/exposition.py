"""Metrics as Prometheus reads them, and promtool's opinion of them."""

import re
import shutil
import subprocess

import pytest

_LINE = re.compile(r"^(\w+)(?:\{(.*)\})? (\S+)$", re.MULTILINE)


def parsed(text):
    """Value by name and labels, the labels as a frozen set of pairs."""
    return {
        (name, frozenset(re.findall(r'(\w+)="([^"]*)"', labels or ""))): float(value)
        for name, labels, value in _LINE.findall(text)
    }


def value(text, name, **labels):
    return parsed(text)[name, frozenset(labels.items())]


def names(text):
    return {name for name, _ in parsed(text)}


def promtool_accepts(text):
    program = shutil.which("promtool")
    if program is None:
        pytest.skip("promtool is not installed (Debian: apt-get install prometheus)")
    done = subprocess.run(
        [program, "check", "metrics"], input=text, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
