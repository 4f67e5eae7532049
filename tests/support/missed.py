"""A mark for rows whose bar is missed."""

import pytest


def missed(figure):
    """The bar stands; what is measured is said, and the mark goes once the bar is met."""
    return pytest.mark.xfail(strict=True, reason=f"missed: {figure}")
