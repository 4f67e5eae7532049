"""A map at one temperature as polynomials on rectangles over U and s = √dp, with bounds."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from valvemap.model.bernstein import bernstein
from valvemap.model.capabilities import InPieces
from valvemap.model.kernels.radial_basis import TAIL
from valvemap.model.map_forms import DEGREES, Gaussians, MapForm, Part, nothing_left
from valvemap.model.model_structures import Polynomial
from valvemap.model.polynomials import TRUE, Polynomials, inside, place_in
from valvemap.model.radial_basis import RadialBasis
from valvemap.model.samples import Floats
from valvemap.model.tensor_spline import TensorSpline

FINEST: Final = (24, 48, 96)  # rectangles along an axis without knots, until the remainder is small
SMALL: Final = 1e-5  # of the largest flow: a smaller remainder needs no finer rectangles
FINE: Final = 192  # rectangles along U, at least, where the least slopes matter
SLIVER: Final = 0.01  # of a rectangle's width; edges that are closer to a knot are left out


@dataclass(frozen=True)
class MapPieces:
    """A map as the larger of one or two polynomials on each rectangle.

    Attributes
    ----------
    parts : (1,) or (2,)
        On the same rectangles.
    slack
        Largest difference of the map from them, l/min.
    """

    parts: tuple[Polynomials, ...]
    slack: float

    @classmethod
    def of(
        cls,
        estimator: Any,  # noqa: ANN401 - any estimator
        state: Any,  # noqa: ANN401 - its own
        dp_range: tuple[float, float],
        T: float,
    ) -> Self | None:
        """Return the pieces; None for a map whose form is not known.

        The polynomials are interpolated, and compared with the map between the points.
        """
        form = _form(estimator, state, T)
        if form is None:
            return None
        for finest in FINEST:
            U = _edges(form.knots_U, 0.0, 100.0, finest)
            s = _edges(form.knots_s, np.sqrt(dp_range[0]), np.sqrt(dp_range[1]), finest)
            parts = tuple(Polynomials.of(U, s, _interpolated(part, U, s)) for part in form.parts)
            largest = max(1.0, *(float(np.abs(part.coefficients).max()) for part in parts))
            pieces = cls(parts, float(form.remainder(U, s).max()))
            if pieces.slack <= SMALL * largest:
                break
        between = np.array([0.0, 0.11, 0.37, 0.52, 0.81, 1.0 - 1e-12])
        at_U, at_s = (inside(edges, between).ravel() for edges in (U, s))
        grid_U, grid_s = (x.ravel() for x in np.meshgrid(at_U, at_s, indexing="ij"))
        exact = estimator.predict(state, grid_U, grid_s**2, np.full(grid_U.size, T))[0]
        apart = np.abs(pieces.at(grid_U, grid_s)[0] - exact).max()
        return pieces if apart <= TRUE * largest + pieces.slack else None

    @property
    def U(self) -> Floats:
        """Edges of the rectangles along U, %."""
        return self.parts[0].U

    @property
    def s(self) -> Floats:
        """Edges of the rectangles along s, √bar."""
        return self.parts[0].s

    @property
    def kinks_U(self) -> NDArray[np.bool_]:
        """Whether a slope jumps at an edge of U."""
        return np.logical_or(self.parts[0].kinks_U, self.parts[-1].kinks_U)

    @property
    def kinks_s(self) -> NDArray[np.bool_]:
        """Whether a slope jumps at an edge of s."""
        return np.logical_or(self.parts[0].kinks_s, self.parts[-1].kinks_s)

    @cached_property
    def gap(self) -> Polynomials | None:
        """How far the first part is above the second; None where there is no second."""
        if len(self.parts) == 1:
            return None
        first, second = self.parts
        return Polynomials.of(self.U, self.s, first.coefficients - second.coefficients)

    @cached_property
    def least(self) -> Floats:
        """Lower bound of dQ/dU on each rectangle, (n_U, n_s)."""
        first: Floats = self.parts[0].slopes[0]
        gap = self.gap
        if gap is None:
            return first
        second: Floats = self.parts[1].slopes[0]
        c = gap.coefficients
        above, below = c.min(axis=(2, 3)) >= 0.0, c.max(axis=(2, 3)) <= 0.0
        return np.asarray(np.select([above, below], [first, second], np.minimum(first, second)))

    @cached_property
    def most(self) -> Floats:
        """Upper bound of dQ/dU on each rectangle, (n_U, n_s)."""
        return np.asarray(np.maximum(self.parts[0].slopes[1], self.parts[-1].slopes[1]))

    @cached_property
    def fine(self) -> "MapPieces":
        """The map on rectangles divided along both axes, where its least slopes are sharper."""
        parts = -(-FINE // (len(self.U) - 1))
        return MapPieces(tuple(part.divided(parts) for part in self.parts), self.slack)

    def extended(self, below: float, above: float, gain: float) -> "MapPieces":
        """Return the map also for U < 0 and U > 100: linear, with slopes gain·s."""
        parts = tuple(part.extended(below, above, gain) for part in self.parts)
        return MapPieces(parts, self.slack)

    def at(self, U: Floats, s: Floats) -> Floats:
        """Flow, dQ/dU and dQ/ds at N points, (3, N)."""
        found = [part.at(U, s) for part in self.parts]
        return np.asarray(np.where(found[0][0] >= found[-1][0], found[0], found[-1]))

    def over(
        self, low_U: Floats, high_U: Floats, low_s: Floats, high_s: Floats
    ) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Bounds over N boxes: slopes (4, N), bends (3, N), and whether a kink is inside.

        A box has a kink, too, unless one part is the larger one all over it.
        """
        box = low_U, high_U, low_s, high_s
        first = self.parts[0].over(*box)
        if self.gap is None:
            return first
        second = self.parts[1].over(*box)
        rises, _, _ = self.gap.over(*box)
        steep = np.abs(rises).reshape(2, 2, -1).max(axis=1)
        reach = (steep[0] * (high_U - low_U) + steep[1] * (high_s - low_s)) / 2.0
        middle = self.gap.at((low_U + high_U) / 2.0, (low_s + high_s) / 2.0)[0]
        above, below = middle > reach, middle < -reach
        signs = np.array([-1.0, 1.0, -1.0, 1.0])[:, None]
        hull = signs * np.maximum(signs * first[0], signs * second[0])
        slopes = np.select([above, below], [first[0], second[0]], hull)
        bends = np.select([above, below], [first[1], second[1]], np.maximum(first[1], second[1]))
        kinked = np.select([above, below], [first[2], second[2]], True)  # noqa: FBT003
        return slopes, bends, np.asarray(kinked, np.bool_)

    def least_slopes(self, low_s: Floats, high_s: Floats) -> Floats:
        """Lower bounds of dQ/dU along U over N ranges of s, (N, n_U)."""
        return -_largest_over(-self.least, self.s, low_s, high_s)

    def may_rise(self, low_s: Floats, high_s: Floats) -> NDArray[np.bool_]:
        """Whether the map may rise with U on each rectangle over N ranges of s, (N, n_U)."""
        return np.asarray(_largest_over(self.most, self.s, low_s, high_s) >= 0.0)


def _largest_over(values: Floats, s: Floats, low_s: Floats, high_s: Floats) -> Floats:
    """Return the largest of values by rectangle (n_U, n_s) over N ranges of s, (N, n_U)."""
    j, last = place_in(s, low_s)[0], place_in(s, high_s, side="left")[0]
    largest = values[:, j]
    for across in range(1, int((last - j).max(initial=0)) + 1):
        largest = np.maximum(largest, values[:, np.minimum(j + across, last)])
    return np.ascontiguousarray(largest.T)


def _form(estimator: Any, state: Any, T: float) -> MapForm | None:  # noqa: ANN401 - any
    """Return the form of an estimator's map at one temperature; None where it is not known."""
    none = np.empty(0)

    def flow(U: Floats, s: Floats) -> Floats:
        return np.asarray(estimator.predict(state, U, s**2, np.full(U.size, T))[0])

    if isinstance(estimator, InPieces):
        return estimator.form(state, T)
    match getattr(estimator, "structure", None):
        case TensorSpline() as spline:
            return MapForm(*spline.knots, (flow,), nothing_left)
        case Polynomial():
            return MapForm(none, none, (flow,), nothing_left)
        case RadialBasis() as basis:
            centres = (x.ravel() for x in np.meshgrid(basis.U, basis.s, indexing="ij"))
            meshes = np.diff(basis.U)[0], np.diff(basis.s)[0]
            (U, s), (a, b) = centres, (np.full(1, basis.width * mesh) for mesh in meshes)
            weights = estimator.parameters(state)[0][TAIL:]
            return MapForm(none, none, (flow,), Gaussians(weights, U, a, s, b, 1).remainder)
        case _:
            return None


def _interpolated(part: Part, U: Floats, s: Floats) -> Floats:
    """Coefficients (n_U, n_s, 6, 7) of a part of a map, from its flows at Chebyshev's points."""
    nodes = [(1.0 - np.cos(np.pi * (np.arange(n + 1) + 0.5) / (n + 1))) / 2 for n in DEGREES]
    to_U, to_s = (np.linalg.inv(bernstein(x, n)) for x, n in zip(nodes, DEGREES, strict=True))
    u, v = inside(U, nodes[0]), inside(s, nodes[1])
    shape = len(u), len(v), len(nodes[0]), len(nodes[1])
    grid_u = np.broadcast_to(u[:, None, :, None], shape)
    grid_v = np.broadcast_to(v[None, :, None, :], shape)
    flows = part(grid_u.ravel(), grid_v.ravel()).reshape(shape)
    return np.asarray(np.einsum("ak,ijkl,bl->ijab", to_U, flows, to_s))


def _edges(knots: Floats, low: float, high: float, count: int) -> Floats:
    """Return the knots within a range, and points between that are not too far apart."""
    even, sliver = np.linspace(low, high, count + 1), SLIVER * (high - low) / count
    within = np.unique(knots[(knots > low + 1e-6 * sliver) & (knots < high - 1e-6 * sliver)])
    apart = np.abs(even[1:-1, None] - within).min(axis=1, initial=np.inf)
    return np.unique(np.concatenate([[low, high], within, even[1:-1][apart > sliver]]))
