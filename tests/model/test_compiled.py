"""Compiled kernels never run with a callee of yesterday: all go through one decorator."""

from pathlib import Path

from valvemap.model import kernels

HERE = Path(kernels.__file__).parent


def test_every_kernel_is_cached_under_a_name_that_changes_with_any_of_them():
    direct = [
        path.name
        for path in HERE.glob("*.py")
        if path.name != "compiled.py" and "njit" in path.read_text("utf-8")
    ]
    assert direct == []
