"""Codes, literals and words of all lookup tables for controllers."""

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.model.flow_table import FlowTable
from valvemap.model.lookup_table import LookupTable
from valvemap.model.samples import Floats

INVALID: Final = -1000.0
FINITE: Final = "1.0e300"  # limit of finite numbers in Structured Text, which has no other test
STATUSES: Final = {
    "OK": 0,
    "ABOVE_REACH": 1,
    "BELOW_REACH": 2,
    "UNIDENTIFIED": 4,
    "NOT_FINITE": 5,
    "OUTSIDE": 6,
    "EXTRAPOLATING": 7,
}


def stated(table: LookupTable | FlowTable) -> str:
    """Return the table's errors in words."""
    errors = error_text(table.error_U), error_text(table.error_Q)
    return f"{errors[0]} % of U, {errors[1]} l/min of Q, {grounds(table)}"


def grounds(table: LookupTable | FlowTable) -> str:
    """Return how the table's errors are known."""
    return "certified over the whole table" if table.certified else "measured at 49 points a cell"


def error_text(error: float) -> str:
    """Return an error rounded up to 4 digits."""
    step = 10.0 ** (math.floor(math.log10(error)) - 3)
    return literal(float(f"{math.ceil(error / step) * step:.4g}"))


def in_a_comment(title: str) -> str:
    """Return a title without line ends and comment delimiters."""
    return "".join(c if c.isalnum() or c in " .,:;=-_%" else "_" for c in title)


def without_nan(U: Floats) -> Floats:
    """Return values with ``INVALID`` for NaN."""
    return np.where(np.isnan(U), INVALID, U)


def c_numbers(values: Iterable[float], per_line: int = 8) -> str:
    """Return literals with commas between."""
    texts = [literal(x) for x in values]
    lines = [texts[k : k + per_line] for k in range(0, len(texts), per_line)]
    return ",\n".join("        " + ", ".join(line) for line in lines)


def literal(x: float) -> str:
    """Return a number as a floating-point literal of both languages."""
    text = f"{x:.12g}"
    if "e" in text:
        mantissa, _, power = text.partition("e")
        return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{int(power)}"
    return text if "." in text else f"{text}.0"


def c_rows(U: Floats) -> str:
    """Return the rows of a table in braces; NaN is ``INVALID``."""
    return ",\n".join("    {\n" + c_numbers(row) + "\n    }" for row in without_nan(U))


def c_marks(guessed: NDArray[np.bool_]) -> str:
    """Return the rows of a mask in braces."""
    return ",\n".join("    { " + ", ".join(str(int(x)) for x in row) + " }" for row in guessed)
