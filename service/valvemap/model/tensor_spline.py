"""A structure of the flow map that adapts locally: cubic B-splines over U, s and T."""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Literal, Self

import numpy as np

from valvemap.errors import ConfigurationError
from valvemap.model.kernels import spline
from valvemap.model.samples import Floats


@dataclass(frozen=True)
class TensorSpline:
    """Tensor product of cubic B-splines over (U, s[, T]): the paper's "partition for local area".

    Q = Σ theta_ij · B_i(U) · B_j(s), s = sign(dp)·√|dp|; at most 16 of the products are not zero
    at a point, so a sample affects only its neighbourhood. With nodes in T every theta_ij is
    interpolated linearly between them. Outside the breaks the map continues along its tangent.

    theta_ij is close to Q at its site (the Greville point), which gives it its name. The prior
    pulls it to the straight line between its neighbours, with the weight of ``smoothness²``
    samples. It is negligible where there are data, and extrapolates smoothly where there are none.

    Attributes
    ----------
    U, s
        Breaks between the cells, in % and √bar, ascending.
    T
        Nodes in °C; none: the map does not depend on T.
    dead_band, saturation
        U in % where the valve begins to open and where it is fully open, if the map has a kink
        there; below the first and above the second the prior pulls the map to a plateau.
    smoothness
        Root of the prior's weight, in samples.
    at_rest
        ``"zero"`` fixes Q = 0 at the first break of s (Q(dp = 0) = 0): these theta are omitted.

    Raises
    ------
    ConfigurationError
        if breaks or nodes do not ascend or are too few, or a kink lies outside them.

    References
    ----------
    C. de Boor, A Practical Guide to Splines, 2001. P. Eilers, B. Marx, Flexible smoothing with
    B-splines and penalties, Statistical Science 11 (1996) 89-121.

    Examples
    --------
    >>> structure = TensorSpline.uniform(6, 4)
    >>> len(structure.parameter_names), structure.parameter_names[0]
    (63, 'Q(0%,0bar)')
    >>> rows = structure.regressors(np.array([50.0]), np.array([100.0]), np.array([40.0]))
    >>> rows.shape, int(np.count_nonzero(rows)), round(float(rows.sum()), 12)
    ((1, 63), 12, 1.0)
    """

    U: tuple[float, ...]
    s: tuple[float, ...]
    T: tuple[float, ...] = ()
    dead_band: float | None = None
    saturation: float | None = None
    smoothness: float = 0.3
    at_rest: Literal["free", "zero"] = "free"

    def __post_init__(self) -> None:
        _check_breaks("U", self.U)
        _check_breaks("s", self.s)
        if list(self.T) != sorted(set(self.T)) or len(self.T) == 1:
            raise ConfigurationError(f"spline: T = {self.T}; two or more ascending nodes, or none")
        if self._kinks != sorted({*self._kinks}.difference(self.U)):
            raise ConfigurationError(
                f"spline: dead_band = {self.dead_band}, saturation = {self.saturation}; "
                f"{self.U[0]} < dead_band < saturation < {self.U[-1]} is allowed, off the breaks"
            )

    @classmethod
    def uniform(
        cls, cells_U: int = 6, cells_s: int = 4, dp_max: float = 200.0, T: tuple[float, ...] = ()
    ) -> Self:
        """Equal cells over U in [0, 100] % and s in [0, √dp_max]: (cells + 3) functions each."""
        U, s = np.linspace(0, 100, cells_U + 1), np.linspace(0, math.sqrt(dp_max), cells_s + 1)
        return cls(tuple(U.tolist()), tuple(s.tolist()), T)

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """The site of each parameter."""
        at_T = [f",{node:.4g}°C" for node in self.T] or [""]
        return tuple(
            f"Q({U:.4g}%,{s * abs(s):.4g}bar{T})" for U, s, T in product(*self.sites, at_T)
        )

    @cached_property
    def knots(self) -> tuple[Floats, Floats]:
        """Clamped knots in U and s: the ends four times."""
        with_kinks = sorted([*self.U, *self._kinks * 3])
        U, s = (np.array([*[x[0]] * 3, *x, *[x[-1]] * 3], np.float64) for x in (with_kinks, self.s))
        return U, s

    @cached_property
    def sites(self) -> tuple[Floats, Floats]:
        """Greville points of the functions in U and s: the means of three inner knots."""
        U, s = ((k[1:-3] + k[2:-2] + k[3:-1]) / 3.0 for k in self.knots)
        return U, s[self.held :]

    def regressors(self, U: Floats, dp: Floats, T: Floats) -> Floats:
        """Rows (N, n) with at most 16 (with T: 32) elements that are not zero."""
        knots_U, knots_s = self.knots
        nodes = np.array(self.T, np.float64)
        return np.asarray(spline.tensor_rows(U, dp, T, knots_U, knots_s, nodes, self.held))

    def coefficients(self, theta: Floats) -> Floats:
        """Return theta (n,) for the kernels: (n_U, n_s, n_T), held parameters included."""
        sites_U, sites_s = self.sites
        table = theta.reshape(len(sites_U), len(sites_s), -1)
        return np.pad(table, ((0, 0), (self.held, 0), (0, 0)))

    def prior(self) -> tuple[Floats, Floats]:
        """Rows that pull each theta to the line between its neighbours; values 0."""
        n_T = max(1, len(self.T))
        along_U, along_s = self.roughness
        one_U, one_s, one_T = np.eye(along_U.shape[1]), np.eye(along_s.shape[1]), np.eye(n_T)
        rows = np.concatenate(
            [
                np.kron(np.kron(along_U, one_s), one_T),
                np.kron(np.kron(one_U, along_s), one_T),
                np.kron(np.kron(one_U, one_s), self.smoothness * np.diff(one_T, axis=0)),
            ]
        )
        return rows, np.zeros(len(rows))

    @cached_property
    def roughness(self) -> tuple[Floats, Floats]:
        """The prior's rows along U (R, n_U) and along s (R, n_s)."""
        sites_s = self.sites[1]
        anchored = sites_s if self.at_rest == "free" else np.concatenate([self.s[:1], sites_s])
        along_s = _bends(anchored)[:, self.held :]
        return self.smoothness * self._bends_and_plateaus(), self.smoothness * along_s

    @property
    def _kinks(self) -> list[float]:
        return [U for U in (self.dead_band, self.saturation) if U is not None]

    def _bends_and_plateaus(self) -> Floats:
        """Bends in U between the kinks, steps beyond them; none across a kink."""
        sites = self.sites[0]
        low = -math.inf if self.dead_band is None else self.dead_band
        high = math.inf if self.saturation is None else self.saturation
        inside = (sites[1:-1] > low) & (sites[1:-1] < high)
        beyond = (sites[1:] <= low) | (sites[:-1] >= high)
        return np.concatenate([_bends(sites)[inside], np.diff(np.eye(len(sites)), axis=0)[beyond]])

    @property
    def held(self) -> int:
        """Number of functions of s that are omitted."""
        return int(self.at_rest == "zero")


def _check_breaks(name: str, breaks: tuple[float, ...]) -> None:
    if len(breaks) < 2 or list(breaks) != sorted({*breaks}) or not all(map(math.isfinite, breaks)):
        raise ConfigurationError(
            f"spline: {name} = {breaks}; two or more ascending breaks are allowed"
        )


def _bends(sites: Floats) -> Floats:
    """Rows (n - 2, n): deviation of each value from the line between its neighbours."""
    left, right = np.diff(sites)[:-1], np.diff(sites)[1:]
    rows = np.zeros((len(sites) - 2, len(sites)))
    every = np.arange(len(sites) - 2)
    rows[every, every] = -right / (left + right)
    rows[every, every + 1] = 1.0
    rows[every, every + 2] = -left / (left + right)
    return rows
