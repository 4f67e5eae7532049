"""Bernstein polynomials: on [0, 1] a polynomial lies between its smallest and largest coefficient.

Reference: G. Farin, Curves and Surfaces for CAGD, 5th ed., 2002, ch. 5-6.
"""

from math import comb

import numpy as np

from valvemap.model.samples import Floats


def bernstein(x: Floats, degree: int) -> Floats:
    """Return the basis at N points, (N, degree + 1): B_k(x) = C(n, k)·x^k·(1 - x)^(n - k).

    >>> bernstein(np.array([0.5]), 2)
    array([[0.25, 0.5 , 0.25]])
    """
    k = np.arange(degree + 1)
    weights = np.array([comb(degree, int(i)) for i in k], np.float64)
    return np.asarray(weights * x[:, None] ** k * (1.0 - x[:, None]) ** (degree - k))
