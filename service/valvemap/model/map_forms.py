"""Knowledge of a map before a polynomial is put through it: knots, and what would be left.

A function that is analytic within the ellipse with foci at the ends of an interval and half axes
(ρ ± 1/ρ)/4 of its width, where it stays below M, differs from the polynomial of degree n through
its values at Chebyshev's points by at most 4·M·ρ⁻ⁿ/(ρ - 1), for every ρ > 1.

Reference: L. N. Trefethen, Approximation Theory and Approximation Practice, 2013, theorem 8.2.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from valvemap.model.samples import Floats

DEGREES: Final = (5, 6)  # of the polynomials, in U and s
RHOS: Final = np.geomspace(1.25, 250.0, 60)  # ρ that are tried: the smallest bound counts
LEBESGUE: Final = 2.2  # of Chebyshev's six points: largest factor on errors at the points

Part = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True)
class MapForm:
    """A map is the largest of some parts, each of them smooth between knots.

    Attributes
    ----------
    knots_U, knots_s
        % and √bar.
    parts
        Flows of one or two at (U, s).
    remainder
        Of the edges of rectangles without knots inside: largest difference (n_U, n_s) of a part
        from its polynomial of DEGREES, l/min.
    """

    knots_U: Floats
    knots_s: Floats
    parts: tuple[Part, ...]
    remainder: Callable[[Floats, Floats], Floats]


@dataclass(frozen=True)
class Gaussians:
    """Σ w_j·exp(-((U - U_j)/a_j)²/2 - ((s^p - s_j)/b_j)²/2), each field (m,); p is 1 or 2."""

    w: Floats
    U: Floats
    a: Floats
    s: Floats
    b: Floats
    power: int

    def remainder(self, edges_U: Floats, edges_s: Floats) -> Floats:
        """See `MapForm`. On [-1, 1] in x and y: ‖f - I_x I_y f‖ ≤ ‖f - I_x f‖ + Λ·‖f - I_y f‖."""

        def in_U(middle: Floats, across: Floats, up: Floats) -> Floats:
            return _most(middle, across, up, self.U, self.a, 1)

        def in_s(middle: Floats, across: Floats, up: Floats) -> Floats:
            return _most(middle, across, up, self.s, self.b, self.power)

        along_U, along_s = (
            left_over(edges_U, DEGREES[0], in_U),
            left_over(edges_s, DEGREES[1], in_s),
        )
        return np.asarray((along_U[:, None] + LEBESGUE * along_s) @ np.abs(self.w))


def left_over(
    edges: Floats, degree: int, most: Callable[[Floats, Floats, Floats], Floats]
) -> Floats:
    """Bound of what a polynomial leaves of a function on n intervals, (n, …).

    ``most(middle, across, up)`` bounds the function on rectangles around the ellipses, (60, n, …),
    from their middles and half widths, (60, n).
    """
    middle, width, rho = (edges[:-1] + edges[1:]) / 2.0, np.diff(edges), RHOS[:, None]
    across, up = width * (rho + 1.0 / rho) / 4.0, width * (rho - 1.0 / rho) / 4.0
    bound = most(np.broadcast_to(middle, across.shape), across, up)
    factor = 4.0 * rho ** (-degree) / (rho - 1.0)
    return np.asarray((bound * factor.reshape(len(RHOS), *[1] * (bound.ndim - 1))).min(axis=0))


def nothing_left(edges_U: Floats, edges_s: Floats) -> Floats:
    """The remainder of a map that is a polynomial of DEGREES on each rectangle."""
    return np.zeros((len(edges_U) - 1, len(edges_s) - 1))


def _most(
    middle: Floats, across: Floats, up: Floats, centre: Floats, width: Floats, power: int
) -> Floats:
    """Largest |exp(-((z^p - c)/b)²/2)| within x = middle ± across, |y| ≤ up."""
    x, half, y = middle[..., None], across[..., None], up[..., None]
    if power == 2:
        most = np.abs(x) + half
        least = np.maximum(np.abs(x) - half, 0.0)
        low, high = least**2 - y**2, most**2
        x, half, y = (low + high) / 2.0, (high - low) / 2.0, 2.0 * most * y
    apart = np.maximum(np.abs(x - centre) - half, 0.0)
    return np.asarray(np.exp(np.minimum((y**2 - apart**2) / (2.0 * width**2), 600.0)))
