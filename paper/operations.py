"""Cost of a step, counted by evaluating its formula on numbers that count operations."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from valvemap.model.rbf_network import RbfNetwork


@dataclass
class Tally:
    """Counters of operations."""

    plain: int = 0
    exponentials: int = 0

    @property
    def cycles(self) -> int:
        """Cycles on a microcontroller with a single-precision FPU: 1 per operation, 100 per exp."""
        return self.plain + 100 * self.exponentials


class Counting:
    """A number without a value that counts each operation in its tally.

    >>> tally = Tally()
    >>> x = Counting(tally)
    >>> _ = (x * x + x) / x
    >>> tally.plain
    3
    """

    def __init__(self, tally: Tally) -> None:
        self._tally = tally

    def __add__(self, other: Self) -> Self:
        self._tally.plain += 1
        return self

    __sub__ = __mul__ = __truediv__ = __add__

    def exp(self) -> Self:
        """Count an exponential."""
        self._tally.exponentials += 1
        return self


def least_squares_step(n: int) -> Tally:
    """Count one sample of eq. (28) with n parameters; P is symmetric, so half is computed."""
    tally = Tally()
    one = Counting(tally)
    P = [[one] * n for _ in range(n)]
    X, theta = [one] * n, [one] * n
    g = [_dot(row, X) for row in P]
    d = one + _dot(X, g)
    L = [g[i] / d for i in range(n)]
    e = one - _dot(X, theta)
    for i in range(n):
        theta[i] = theta[i] + L[i] * e
        for j in range(i + 1):
            P[i][j] = (P[i][j] - L[i] * g[j]) / one
    return tally


def network_step(network: RbfNetwork) -> Tally:
    """Count one sample of the corrected eqs. (30)-(38) with two inputs."""
    tally = Tally()
    one = Counting(tally)
    m = network.grid[0] * network.grid[1]
    eta, alpha, w, c, b = (one for _ in range(5))
    H, square, r = one, one, one
    for _ in range(m):
        for _ in range(2):
            r = one - c
            square = square + r * r
        H = (square / (b * b)).exp()  # (30), 2·b² kept
        _ = one + w * H  # (31)
    step = eta * one
    for _ in range(m):
        shared = step * H
        _ = w + shared + alpha * one  # (33), (34)
        pull = shared * w / (b * b)
        _ = b + pull * square / b + alpha * one  # (35), (36)
        for _ in range(2):
            _ = c + pull * r + alpha * one  # (37), (38)
    return tally


def explicit_inverse() -> Tally:
    """Count one evaluation of U = (Q - a1 - a3·s - a5·s²)/(a2 + a4·s), with s given."""
    tally = Tally()
    x = Counting(tally)
    _ = (x - x - x * x - x * x * x) / (x + x * x)
    return tally


def linear_map(n: int) -> Tally:
    """Count one evaluation of Xᵀ·theta, with the two products in X."""
    tally = Tally()
    x = Counting(tally)
    _ = x * x
    _ = x * x
    _dot([x] * n, [x] * n)
    return tally


def _dot(a: Sequence[Counting], b: Sequence[Counting]) -> Counting:
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total
