"""What is fetched ahead is fetched, and nothing else happens."""

from typing import NamedTuple

import numpy as np
from numba import njit

from valvemap.model.kernels.compiled import kernel
from valvemap.model.kernels.prefetch import fetch
from valvemap.model.kernels.prefetch_instruction import LINE
from valvemap.model.samples import Floats


class Memory(NamedTuple):
    one: Floats
    other: Floats


@kernel
def total(memory: Memory) -> float:
    found = 0.0
    for m in range(len(memory.one)):
        if m + 1 < len(memory.one):
            fetch(memory, m + 1)
            fetch(memory.one, m + 1)
        found += memory.one[m].sum() + memory.other[m].sum()
    return found


def test_what_is_computed_stays_the_same() -> None:
    memory = Memory(np.arange(40.0).reshape(10, 4), np.ones((10, 3 * LINE)))
    assert total(memory) == 780.0 + 30.0 * LINE
    assert np.array_equal(memory.one, np.arange(40.0).reshape(10, 4))


def test_rows_of_every_array_are_fetched() -> None:
    compiled = njit(total.py_func)  # type: ignore[attr-defined] # code from a cache shows no IR
    compiled(Memory(np.zeros((1, 4)), np.zeros((1, 4))))
    (code,) = compiled.inspect_llvm().values()
    assert code.count("call void @llvm.prefetch") >= 3


def test_empty_rows_are_no_harm() -> None:
    assert total(Memory(np.zeros((2, 0)), np.zeros((2, 0)))) == 0.0
