"""Radial basis functions with fixed centres: linear in their weights, for RLS and RML."""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Self

import numpy as np

from valvemap.errors import ConfigurationError
from valvemap.model.kernels import radial_basis as kernel
from valvemap.model.samples import Floats


@dataclass(frozen=True)
class RadialBasis:
    """Eq. (7), and a grid of Gaussians over (U, s) for its residual.

    ::

        Q = a1 + a2·U + a3·s + a4·U·s + a5·s·|s| + Σ w_j·H_j,   s = sign(dp)·√|dp|
        H_j = exp(-((U - U_j)/b_U)²/2 - ((s - s_j)/b_s)²/2)      eq. (30) with fixed c_j and b

    The paper's network trains centres and widths by gradient descent and loses accuracy in one
    region while it trains in another. Here only the weights are estimated, by least squares: the
    order of the samples does not affect the map. The grid extends one mesh beyond the ranges to
    avoid edge effects. A weak prior pulls the weights to 0, so that cells without samples, and all
    points outside the grid, follow eq. (7).

    Attributes
    ----------
    U, s
        Centres in % and √bar, two or more, ascending and evenly spaced.
    width
        b in meshes.
    smoothness
        Root of the prior's weight, in samples.

    Raises
    ------
    ConfigurationError
        if centres are not even, or width or smoothness is not positive.

    References
    ----------
    J. Moody, C. Darken, Fast learning in networks of locally-tuned processing units, Neural
    Computation 1 (1989) 281-294. M. Buhmann, Radial Basis Functions, 2003.

    Examples
    --------
    >>> structure = RadialBasis.uniform(6, 4)
    >>> len(structure.parameter_names), structure.parameter_names[5]
    (68, 'w(-16.67%,-3.536√bar)')
    >>> structure.regressors(np.array([50.0]), np.array([100.0]), np.array([40.0]))[0, :5]
    array([  1.,  50.,  10., 500., 100.])
    """

    U: tuple[float, ...]
    s: tuple[float, ...]
    width: float = 1.0
    smoothness: float = 0.03

    def __post_init__(self) -> None:
        for name, centres in (("U", self.U), ("s", self.s)):
            meshes = np.diff(centres)
            even = len(meshes) > 0 and np.allclose(meshes, meshes[0], rtol=1e-6)
            if not (even and np.isfinite(centres).all() and meshes[0] > 0):
                raise ConfigurationError(
                    f"radial basis: {name} = {centres}; two or more evenly ascending centres"
                )
        for name, value in (("width", self.width), ("smoothness", self.smoothness)):
            if not 0 < value < math.inf:
                raise ConfigurationError(f"radial basis: {name} = {value}; it must be positive")

    @classmethod
    def uniform(cls, cells_U: int = 6, cells_s: int = 4, dp_max: float = 200.0) -> Self:
        """Centres on the corners of equal cells over U in [0, 100] %, s in [0, √dp_max], and one
        mesh beyond: (cells + 3) of them each way.
        """  # noqa: D205 - one sentence
        U = np.arange(-1, cells_U + 2) * (100.0 / cells_U)
        s = np.arange(-1, cells_s + 2) * (math.sqrt(dp_max) / cells_s)
        return cls(tuple(U.tolist()), tuple(s.tolist()))

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """The paper's a1 … a5, then each weight with its centre."""
        tail = tuple(f"a{i + 1}" for i in range(kernel.TAIL))
        return tail + tuple(f"w({U:.4g}%,{s:.4g}√bar)" for U, s in product(self.U, self.s))

    def regressors(self, U: Floats, dp: Floats, T: Floats) -> Floats:  # noqa: ARG002 - protocol
        """Rows (N, 5 + n_U·n_s)."""
        centres_U, centres_s = np.array(self.U, np.float64), np.array(self.s, np.float64)
        return np.asarray(
            kernel.rows(
                np.ascontiguousarray(U, np.float64),
                np.ascontiguousarray(dp, np.float64),
                centres_U,
                centres_s,
                self.width * (centres_U[1] - centres_U[0]),
                self.width * (centres_s[1] - centres_s[0]),
            )
        )

    def prior(self) -> tuple[Floats, Floats]:
        """Rows that pull each weight to 0."""
        rows = self.smoothness * np.eye(len(self.parameter_names))[kernel.TAIL :]
        return rows, np.zeros(len(rows))
