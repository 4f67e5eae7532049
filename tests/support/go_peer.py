"""gopcua as a client of our servers; its program is built once."""

import pytest

from benchmarks.foreign_clients import BUILT, Missing, built
from support.building import building


def program():
    """Return the command of the program; skip the test where it cannot be built."""
    try:
        with building(BUILT):
            return (built("gopcua") / "bin" / "every",)
    except Missing as why:
        pytest.skip(f"gopcua: {why}")
