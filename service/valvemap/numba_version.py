"""Which numba is installed, and whether this process may change parts of it.

Importing valvemap changes nothing of numba. A command owns its process and may: it asks for the
shortcuts of `valvemap.model.kernels.numba_seams` by `ask_for_shortcuts`. They, and the
classes of numba that the kernels extend, are private parts, tested with the minor versions below.
With any other version the kernels are compiled by numba's public options alone. A command that
computes a few numbers does without numba, whose import takes longer: `leave_out`.
"""

import logging
import sys
from functools import cache
from importlib.metadata import version
from typing import Final

TESTED: Final = ("0.67", "0.68")
"""Minor versions of numba whose private parts the tests use: the newest and the one before it."""

_asked = _left_out = False


@cache
def is_tested() -> bool:
    """Whether numba is of a tested version; logs one line if it is not."""
    installed = version("numba")
    if ".".join(installed.split(".")[:2]) in TESTED:
        return True
    logging.getLogger(__name__).warning(
        "numba %s is none of the tested %s: kernels are compiled and loaded more slowly",
        installed,
        ", ".join(TESTED),
    )
    return False


def ask_for_shortcuts() -> None:
    """Let the kernels change numba in this process; call it before they are imported."""
    global _asked  # noqa: PLW0603 - numba's parts are global, too
    _asked = True


def are_shortcuts_asked_for() -> bool:
    """Whether `ask_for_shortcuts` was called in this process."""
    return _asked


def leave_out() -> None:
    """Let kernels run as plain Python, if this is a command's process and numba is not here yet."""
    global _left_out  # noqa: PLW0603 - as above
    _left_out = _asked and "numba" not in sys.modules


def is_left_out() -> bool:
    """Whether kernels run as plain Python in this process."""
    return _left_out
