"""Cases that say the same of another seed or size: they run in the soak alone."""

import pytest


def soaked(*cases):
    """The cases of a parametrization, marked; one of several arguments is a tuple."""
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.soak)
        for case in cases
    ]
