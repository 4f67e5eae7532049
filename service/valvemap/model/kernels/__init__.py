"""Fixed-order loops over samples, compiled by numba; no BLAS over the batch axis."""
