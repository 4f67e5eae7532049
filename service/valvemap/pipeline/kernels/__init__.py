"""Loops over data changes and samples, compiled by numba."""
