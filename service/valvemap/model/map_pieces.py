"""A map at one temperature as polynomials on rectangles over U and s = √dp, with bounds."""

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from valvemap.model.bernstein import bernstein
from valvemap.model.model_structures import Polynomial, TensorSpline
from valvemap.model.samples import Floats

DEGREES: Final = (5, 6)  # in U and s, at most
FINEST: Final = 24  # rectangles along an axis without knots
TRUE: Final = 1e-9  # of the largest flow: a map that differs more is no such polynomial
SHARP: Final = 1e-6  # of the largest slope: a larger jump of a slope is a kink

Indices = NDArray[np.intp]


@dataclass(frozen=True)
class MapPieces:
    """Polynomials in Bernstein form: their coefficients bound them, and their derivatives.

    Attributes
    ----------
    U, s : (n_U + 1,), (n_s + 1,)
        Edges of the rectangles, % and √bar.
    coefficients : (n_U, n_s, 6, 7)
        Of the flow.
    slopes : (4, n_U, n_s)
        Bounds of dQ/dU (low, high) and dQ/ds (low, high).
    bends : (3, n_U, n_s)
        Largest |d²Q/dU²|, |d²Q/dU ds|, |d²Q/ds²|.
    kinks_U, kinks_s : (n_U + 1,), (n_s + 1,)
        Whether a slope jumps at an edge.
    """

    U: Floats
    s: Floats
    coefficients: Floats
    slopes: Floats
    bends: Floats
    kinks_U: NDArray[np.bool_]
    kinks_s: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        estimator: Any,  # noqa: ANN401 - any estimator
        state: Any,  # noqa: ANN401 - its own
        dp_range: tuple[float, float],
        T: float,
    ) -> Self | None:
        """Return the pieces of a polynomial or a spline; None for other maps.

        The polynomials are interpolated, and compared with the map between the points.
        """
        knots = _knots(estimator)
        if knots is None:
            return None
        knots_U, knots_s = knots
        U = _edges(knots_U, 0.0, 100.0)
        s = _edges(knots_s, *np.sqrt(dp_range))

        def flow(at_U: Floats, at_s: Floats) -> Floats:
            """Flows (n_U, n_s, k, l) at shares of each rectangle."""
            u = U[:-1, None] + np.diff(U)[:, None] * at_U
            v = s[:-1, None] + np.diff(s)[:, None] * at_s
            shape = len(U) - 1, len(s) - 1, len(at_U), len(at_s)
            grid_u = np.broadcast_to(u[:, None, :, None], shape)
            grid_v = np.broadcast_to(v[None, :, None, :], shape)
            points = grid_u.ravel(), grid_v.ravel() ** 2, np.full(grid_u.size, T)
            return np.asarray(estimator.predict(state, *points)[0]).reshape(shape)

        nodes = [(1.0 - np.cos(np.pi * (np.arange(n + 1) + 0.5) / (n + 1))) / 2 for n in DEGREES]
        to_U, to_s = (np.linalg.inv(bernstein(x, n)) for x, n in zip(nodes, DEGREES, strict=True))
        coefficients = np.einsum("ak,ijkl,bl->ijab", to_U, flow(*nodes), to_s)
        between = np.array([0.0, 0.11, 0.37, 0.52, 0.81, 1.0 - 1e-12])
        bases = [bernstein(between, n) for n in DEGREES]
        again = np.einsum("ka,ijab,lb->ijkl", bases[0], coefficients, bases[1])
        apart = np.abs(again - flow(between, between)).max()
        if not apart <= TRUE * max(float(np.abs(coefficients).max()), 1.0):
            return None
        return cls.from_coefficients(U, s, coefficients)

    @classmethod
    def from_coefficients(cls, U: Floats, s: Floats, coefficients: Floats) -> Self:
        """Return the pieces with their bounds."""
        widths = np.diff(U)[:, None, None, None], np.diff(s)[None, :, None, None]
        by_U = _derivative(coefficients, 2, widths[0])
        by_s = _derivative(coefficients, 3, widths[1])
        bends = [_derivative(by_U, 2, widths[0]), _derivative(by_U, 3, widths[1])]
        bends.append(_derivative(by_s, 3, widths[1]))
        return cls(
            U=U,
            s=s,
            coefficients=coefficients,
            slopes=np.stack([f(x, axis=(2, 3)) for x in (by_U, by_s) for f in (np.min, np.max)]),
            bends=np.stack([np.abs(x).max(axis=(2, 3)) for x in bends]),
            kinks_U=_jumps(by_U[:, :, -1].swapaxes(0, 1), by_U[:, :, 0].swapaxes(0, 1)),
            kinks_s=_jumps(by_s[:, :, :, -1], by_s[:, :, :, 0]),
        )

    def extended(self, below: float, above: float, gain: float) -> "MapPieces":
        """Return the map also for U < 0 and U > 100: linear, with slopes gain·s."""
        at_s = self.s[:-1, None] + np.diff(self.s)[:, None] * np.linspace(0, 1, DEGREES[1] + 1)

        def linear(end: Floats, start: float, stop: float) -> Floats:
            along = np.linspace(start, stop, DEGREES[0] + 1)[:, None]
            return np.asarray((end[:, None] + gain * along * at_s[:, None])[None])

        lower = linear(self.coefficients[0, :, 0], below, 0.0)
        upper = linear(self.coefficients[-1, :, -1], 0.0, above - 100.0)
        U = np.concatenate([[below], self.U, [above]])
        whole = np.concatenate([lower, self.coefficients, upper])
        return self.from_coefficients(U, self.s, whole)

    def at(self, U: Floats, s: Floats) -> tuple[Floats, Floats, Floats]:
        """Flow, dQ/dU and dQ/ds at N points."""
        i, u = _place(self.U, U)
        j, v = _place(self.s, s)
        c = self.coefficients[i, j]
        in_U, in_s = bernstein(u, DEGREES[0]), bernstein(v, DEGREES[1])
        Q = np.einsum("na,nab,nb->n", in_U, c, in_s)
        width_U, width_s = np.diff(self.U)[i], np.diff(self.s)[j]
        lower_U, lower_s = bernstein(u, DEGREES[0] - 1), bernstein(v, DEGREES[1] - 1)
        by_U = np.einsum("na,nab,nb->n", lower_U, np.diff(c, axis=1), in_s)
        by_s = np.einsum("na,nab,nb->n", in_U, np.diff(c, axis=2), lower_s)
        return Q, DEGREES[0] * by_U / width_U, DEGREES[1] * by_s / width_s

    def over(
        self, low_U: Floats, high_U: Floats, low_s: Floats, high_s: Floats
    ) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Bounds over N boxes: slopes (4, N), bends (3, N), and whether a kink is inside."""
        i, last_i = _place(self.U, low_U)[0], _place(self.U, high_U, side="left")[0]
        j, last_j = _place(self.s, low_s)[0], _place(self.s, high_s, side="left")[0]
        slopes, bends = self.slopes[:, i, j].copy(), self.bends[:, i, j].copy()
        signs = np.array([-1.0, 1.0, -1.0, 1.0])[:, None]
        kinked = np.zeros(len(i), np.bool_)
        for along in range(int((last_i - i).max(initial=0)) + 1):
            a = np.minimum(i + along, last_i)
            kinked |= self.kinks_U[a] & (a > i)
            for across in range(int((last_j - j).max(initial=0)) + 1):
                b = np.minimum(j + across, last_j)
                kinked |= self.kinks_s[b] & (b > j)
                slopes = signs * np.maximum(signs * slopes, signs * self.slopes[:, a, b])
                bends = np.maximum(bends, self.bends[:, a, b])
        return slopes, bends, kinked

    def least_slopes(self, low_s: Floats, high_s: Floats) -> Floats:
        """Lower bounds of dQ/dU along U over N ranges of s, (N, n_U)."""
        j, last = _place(self.s, low_s)[0], _place(self.s, high_s, side="left")[0]
        least = self.slopes[0][:, j]
        for across in range(1, int((last - j).max(initial=0)) + 1):
            least = np.minimum(least, self.slopes[0][:, np.minimum(j + across, last)])
        return np.ascontiguousarray(least.T)


def _knots(estimator: Any) -> tuple[Floats, Floats] | None:  # noqa: ANN401 - any
    """Return the knots of a spline, none for a polynomial; None for other maps."""
    match getattr(estimator, "structure", None):
        case TensorSpline() as spline:
            return spline.knots
        case Polynomial():
            return np.empty(0), np.empty(0)
        case _:
            return None


def _edges(knots: Floats, low: float, high: float) -> Floats:
    """Return the knots within a range, and points between that are not too far apart."""
    within = knots[(knots > low) & (knots < high)]
    return np.unique(np.concatenate([within, np.linspace(low, high, FINEST + 1)]))


def _derivative(coefficients: Floats, axis: int, widths: Floats) -> Floats:
    degree = coefficients.shape[axis] - 1
    return np.asarray(degree * np.diff(coefficients, axis=axis) / widths)


def _jumps(after: Floats, before: Floats) -> NDArray[np.bool_]:
    """Whether the slope of the piece before an edge differs from that behind; axis 1: pieces."""
    sharp = SHARP * max(float(np.abs(after).max()), float(np.abs(before).max()), 1e-300)
    inner = np.abs(after[:, :-1] - before[:, 1:]).max(axis=(0, 2)) > sharp
    return np.concatenate([[False], inner, [False]])


def _place(edges: Floats, x: Floats, side: Any = "right") -> tuple[Indices, Floats]:  # noqa: ANN401
    i = np.clip(np.searchsorted(edges, x, side=side) - 1, 0, len(edges) - 2)
    return i, (x - edges[i]) / (edges[i + 1] - edges[i])
