"""Estimators and maps: pure functions on arrays, no I/O, no clock, no logging."""

from service.identification.maximum_likelihood import recursive_maximum_likelihood
from service.identification.recursive_least_squares import recursive_least_squares

__all__ = ["recursive_least_squares", "recursive_maximum_likelihood"]
