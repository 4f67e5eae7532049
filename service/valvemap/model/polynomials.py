"""Polynomials in Bernstein form on rectangles over U and s = √dp, with bounds."""

from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from valvemap.model.bernstein import bernstein
from valvemap.model.map_forms import DEGREES
from valvemap.model.samples import Floats

TRUE: Final = 1e-9  # of the largest flow: a map that differs more is no such polynomial
_SHARP: Final = 1e-6  # of the largest slope: a larger jump of a slope is a kink
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Polynomials:
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
    def of(cls, U: Floats, s: Floats, coefficients: Floats) -> Self:
        """Return the polynomials with their bounds."""
        widths = np.diff(U)[:, None, None, None], np.diff(s)[None, :, None, None]
        by_U = _derivative(coefficients, 2, widths[0])
        by_s = _derivative(coefficients, 3, widths[1])
        bends = [_derivative(by_U, 2, widths[0]), _derivative(by_U, 3, widths[1])]
        bends.append(_derivative(by_s, 3, widths[1]))
        rounding = TRUE * float(np.abs(coefficients).max())
        return cls(
            U=U,
            s=s,
            coefficients=coefficients,
            slopes=np.stack([f(x, axis=(2, 3)) for x in (by_U, by_s) for f in (np.min, np.max)]),
            bends=np.stack([np.abs(x).max(axis=(2, 3)) for x in bends]),
            kinks_U=_jumps(by_U[:, :, -1].swapaxes(0, 1), by_U[:, :, 0].swapaxes(0, 1), rounding),
            kinks_s=_jumps(by_s[:, :, :, -1], by_s[:, :, :, 0], rounding),
        )

    def extended(self, below: float, above: float, gain: float) -> "Polynomials":
        """Return them also for U < 0 and U > 100: linear, with slopes gain·s."""
        at_s = self.s[:-1, None] + np.diff(self.s)[:, None] * np.linspace(0, 1, DEGREES[1] + 1)

        def linear(end: Floats, start: float, stop: float) -> Floats:
            along = np.linspace(start, stop, DEGREES[0] + 1)[:, None]
            return np.asarray((end[:, None] + gain * along * at_s[:, None])[None])

        lower = linear(self.coefficients[0, :, 0], below, 0.0)
        upper = linear(self.coefficients[-1, :, -1], 0.0, above - 100.0)
        U = np.concatenate([[below], self.U, [above]])
        whole = np.concatenate([lower, self.coefficients, upper])
        return self.of(U, self.s, whole)

    def divided(self, parts: int) -> "Polynomials":
        """Return them on rectangles divided along both axes, where their bounds are sharper."""
        to_U, to_s = (_division(n, parts) for n in DEGREES)
        shape = parts * len(self.coefficients), parts * self.coefficients.shape[1]
        whole = np.einsum("pka,ijab,qlb->ipjqkl", to_U, self.coefficients, to_s)
        U, s = (_between(edges, parts) for edges in (self.U, self.s))
        return self.of(U, s, whole.reshape(*shape, *whole.shape[-2:]))

    def at(self, U: Floats, s: Floats) -> Floats:
        """Flow, dQ/dU and dQ/ds at N points, (3, N)."""
        i, u = place_in(self.U, U)
        j, v = place_in(self.s, s)
        c = self.coefficients[i, j]
        in_U, in_s = bernstein(u, DEGREES[0]), bernstein(v, DEGREES[1])
        Q = np.einsum("na,nab,nb->n", in_U, c, in_s)
        width_U, width_s = np.diff(self.U)[i], np.diff(self.s)[j]
        lower_U, lower_s = bernstein(u, DEGREES[0] - 1), bernstein(v, DEGREES[1] - 1)
        by_U = np.einsum("na,nab,nb->n", lower_U, np.diff(c, axis=1), in_s)
        by_s = np.einsum("na,nab,nb->n", in_U, np.diff(c, axis=2), lower_s)
        return np.stack([Q, DEGREES[0] * by_U / width_U, DEGREES[1] * by_s / width_s])

    def over(
        self, low_U: Floats, high_U: Floats, low_s: Floats, high_s: Floats
    ) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Bounds over N boxes: slopes (4, N), bends (3, N), and whether a kink is inside."""
        i, last_i = place_in(self.U, low_U)[0], place_in(self.U, high_U, side="left")[0]
        j, last_j = place_in(self.s, low_s)[0], place_in(self.s, high_s, side="left")[0]
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


def _division(degree: int, parts: int) -> Floats:
    """Matrices that give the coefficients on each of some equal parts, (parts, n + 1, n + 1)."""
    nodes = np.linspace(0.0, 1.0, degree + 1)
    back = np.linalg.inv(bernstein(nodes, degree))
    return np.stack([back @ bernstein((p + nodes) / parts, degree) for p in range(parts)])


def _between(edges: Floats, parts: int) -> Floats:
    """Edges of equal parts of each interval."""
    return np.append(inside(edges, np.arange(parts) / parts).ravel(), edges[-1])


def _derivative(coefficients: Floats, axis: int, widths: Floats) -> Floats:
    degree = coefficients.shape[axis] - 1
    return np.asarray(degree * np.diff(coefficients, axis=axis) / widths)


def _jumps(after: Floats, before: Floats, rounding: float) -> NDArray[np.bool_]:
    """Whether the slope of the piece before an edge differs from that behind; axis 1: pieces."""
    sharp = max(_SHARP * float(max(np.abs(after).max(), np.abs(before).max())), rounding, 1e-300)
    inner = np.abs(after[:, :-1] - before[:, 1:]).max(axis=(0, 2)) > sharp
    return np.concatenate([[False], inner, [False]])


def place_in(edges: Floats, x: Floats, side: Any = "right") -> tuple[Indices, Floats]:  # noqa: ANN401
    """Return the rectangle of each x and its share of the width from the lower edge, 0 to 1."""
    i = np.clip(np.searchsorted(edges, x, side=side) - 1, 0, len(edges) - 2)
    return i, (x - edges[i]) / (edges[i + 1] - edges[i])


def inside(edges: Floats, shares: Floats) -> Floats:
    """Points at shares of each interval, (n, k)."""
    return np.asarray(edges[:-1, None] + np.diff(edges)[:, None] * shares)
