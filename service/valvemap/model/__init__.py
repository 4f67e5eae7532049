"""Estimators and maps: pure functions on arrays, no I/O, no clock, no logging."""

from valvemap.model.maximum_likelihood import recursive_maximum_likelihood
from valvemap.model.recursive_least_squares import recursive_least_squares

__all__ = ["recursive_least_squares", "recursive_maximum_likelihood"]
