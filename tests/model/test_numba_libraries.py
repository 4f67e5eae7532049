"""Kernels that were compiled before are loaded whole; inner functions are for kernels alone."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.minor  # compiles for half a minute

KERNELS = """
import sys
from valvemap.model.kernels.compiled import inner, kernel

@inner
def tripled(x):
    return 3.0 * x

@kernel
def one_more(x):
    return tripled(x) + 1.0

@kernel
def twice(x):
    return 2.0 * one_more(x)

for name in sys.argv[1:]:
    print(globals()[name](2.0))
"""
BESIDE_PYTHON = """
from numba import objmode
from valvemap.model.kernels.compiled import inner, kernel

@inner
def says(x):
    with objmode():
        print(x)
    return x

@kernel
def calls(x):
    return says(x)

calls(2.0)
"""


def run(tmp_path, source, *arguments):
    file = tmp_path / "kernels_of_a_test.py"
    file.write_text(source)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, str(file), *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, env=environment, check=False, timeout=120
    )


def test_a_kernel_that_was_compiled_before_is_linked_into_one_that_was_not(tmp_path):
    assert run(tmp_path, KERNELS, "one_more").stdout.split() == ["7.0"]
    again = run(tmp_path, KERNELS, "one_more", "twice")
    assert again.stdout.split() == ["7.0", "14.0"], again.stderr
    assert run(tmp_path, KERNELS, "twice").stdout.split() == ["14.0"]


def test_an_inner_function_that_needs_python_is_refused(tmp_path):
    done = run(tmp_path, BESIDE_PYTHON)
    assert done.returncode == 1, done
    assert "missing Environment" in done.stderr
