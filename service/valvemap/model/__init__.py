"""Estimators and maps: pure functions on arrays, no I/O, no clock, no logging."""
