"""Structures of the flow map: Q = X(U, dp, T)ᵀ·theta."""

import math
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Final, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from valvemap.errors import ConfigurationError
from valvemap.model.kernels import polynomial
from valvemap.model.protocol_checks import CheckedByClass
from valvemap.model.samples import Floats, Samples

EQ_7: Final = frozenset({"1", "U", "s", "U*s", "dp"})
WALTHER_SHIFT: Final = 0.7
KELVIN: Final = 273.15


class Structure(Protocol):
    """A structure that is linear in its parameters; frozen, hashable by its fields."""

    def __hash__(self) -> int:
        """By the fields."""

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of theta's n elements, as published."""

    def regressors(self, U: Floats, dp: Floats, T: Floats) -> Floats:
        """Return rows Xᵀ (N, n) at N points; a row depends on its point only, bit by bit."""


@runtime_checkable
class StructureOfSignals(Structure, Protocol, metaclass=CheckedByClass):
    """A structure that uses further signals of a sample, such as optional ones.

    `regressors` is for points of which only U, dp and T are known; there it assumes usual values
    of the further signals, as for a sample in which they are NaN.
    """

    def regressors_of(self, samples: Samples) -> Floats:
        """Return rows Xᵀ (N, n) of N samples."""


def rows_of(structure: Structure, samples: Samples) -> Floats:
    """Return the rows Xᵀ (N, n) of N samples, by all signals that the structure uses."""
    of_signals: Callable[[Samples], Floats] | None = getattr(structure, "regressors_of", None)
    if of_signals is not None:  # a `StructureOfSignals`: to ask the protocol takes 0.3 ms
        return of_signals(samples)
    return structure.regressors(samples.U, samples.dp, samples.T)


def reads_temperature(structure: Structure) -> bool:
    """Whether the rows Xᵀ depend on the oil temperature."""
    U, dp, T = np.full(2, 50.0), np.full(2, 100.0), np.array([20.0, 60.0])
    cold, warm = structure.regressors(U, dp, T)
    return not np.array_equal(cold, warm)


@runtime_checkable
class StructureWithPrior(Structure, Protocol, metaclass=CheckedByClass):
    """A structure with prior knowledge of its parameters.

    An estimator adds the prior to its initial information as pseudo-samples: row·theta = value,
    each with the weight (noise variance) of one measured sample. They affect neither the sample
    count nor the noise variance.
    """

    def prior(self) -> tuple[Floats, Floats]:
        """Rows (R, n) and values (R,), l/min."""


@dataclass(frozen=True)
class Polynomial:
    """Any sum of products of powers: Q = Σ theta_j · term_j (eqs. (7), (9)).

    Attributes
    ----------
    terms
        Each a product like ``"1"``, ``"U"``, ``"U^2*s"``, ``"dp*nu^-1"`` of the factors U (%),
        s = sign(dp)·√|dp| (√bar), ``|s|``, dp (bar), ``|dp|``, T (°C) and nu, the oil's kinematic
        viscosity at T (mm²/s, Walther's equation, ASTM D341).
    names
        Names of the parameters; the terms themselves where none are given.
    viscosity_40, viscosity_100
        The oil's viscosity at 40 °C and 100 °C, mm²/s; VG 46 by default.

    Raises
    ------
    ConfigurationError
        if a term cannot be parsed or is repeated.

    Examples
    --------
    >>> laminar_too = Polynomial(terms=("s", "U*s", "dp*nu^-1"))
    >>> laminar_too.regressors(np.array([50.0]), np.array([100.0]), np.array([40.0])).round(3)
    array([[ 10.   , 500.   ,   2.174]])
    """

    terms: tuple[str, ...]
    names: tuple[str, ...] = ()
    viscosity_40: float = 46.0
    viscosity_100: float = 6.8

    def __post_init__(self) -> None:
        if not self.terms:
            raise ConfigurationError("polynomial: no terms; give one at least, e.g. U*s")
        twice = [key for key, count in Counter(map(_exponents, self.terms)).items() if count > 1]
        if twice:
            same = ", ".join(term for term in self.terms if _exponents(term) == twice[0])
            raise ConfigurationError(f"polynomial: terms {same} are the same")
        if self.names and len(self.names) != len(self.terms):
            raise ConfigurationError(
                f"polynomial: {len(self.names)} names for {len(self.terms)} terms"
            )
        if not self.viscosity_40 > self.viscosity_100 > WALTHER_SHIFT:
            raise ConfigurationError(
                f"polynomial: viscosity_40 = {self.viscosity_40} and viscosity_100 = "
                f"{self.viscosity_100}; viscosity_40 > viscosity_100 > 0.7 mm²/s is allowed"
            )

    @classmethod
    def of_order(cls, order: int) -> Self:
        """All products U^i·s^j with i + j <= order.

        >>> Polynomial.of_order(2).terms
        ('1', 's', 's^2', 'U', 'U*s', 'U^2')
        """
        powers = [(i, j) for i, j in product(range(order + 1), repeat=2) if i + j <= order]
        return cls(terms=tuple(_spell({"U": i, "s": j}) for i, j in powers))

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The names, or else the terms."""
        return self.names or self.terms

    @property
    def powers_of_U(self) -> NDArray[np.int64]:
        """Exponent of U in each term."""
        return self._table[:, 0]

    @cached_property
    def is_affine_in_U(self) -> bool:
        """Whether U appears to the first power at most."""
        return set(self.powers_of_U.tolist()) <= {0, 1}

    @cached_property
    def is_eq7(self) -> bool:
        """Whether the terms are those of eq. (7)."""
        return set(self.terms) == EQ_7

    def regressors(self, U: Floats, dp: Floats, T: Floats) -> Floats:
        """Rows (N, n): the terms at N points."""
        return np.asarray(polynomial.products(U, dp, T, self._table, self._walther))

    @cached_property
    def _table(self) -> NDArray[np.int64]:
        return np.array([_exponents(term) for term in self.terms], np.int64)

    @cached_property
    def _walther(self) -> tuple[float, float]:
        """Make a and b of lg lg(nu + 0.7) = a - b·lg(T in K) from the two viscosities."""
        at_40, at_100 = (
            math.log10(math.log10(nu + WALTHER_SHIFT))
            for nu in (self.viscosity_40, self.viscosity_100)
        )
        lg_40, lg_100 = math.log10(40.0 + KELVIN), math.log10(100.0 + KELVIN)
        b = (at_40 - at_100) / (lg_100 - lg_40)
        return at_40 + b * lg_40, b


@dataclass(frozen=True)
class FiveTerms(Polynomial):
    """The paper's structure, eq. (7): Q = a1 + a2·U + a3·s + a4·U·s + a5·s·|s|, s = √dp.

    With s = sign(dp)·√|dp| (√bar) the flow may change its direction; a5·s·|s| is a5·dp.

    Examples
    --------
    >>> FiveTerms().regressors(np.array([50.0]), np.array([100.0]), np.array([40.0]))
    array([[  1.,  50.,  10., 500., 100.]])
    """

    terms: tuple[str, ...] = ("1", "U", "s", "U*s", "dp")
    names: tuple[str, ...] = ("a1", "a2", "a3", "a4", "a5")


_FACTOR = re.compile(r"(U|s|\|s\||dp|\|dp\||T|nu)(?:\^(-?\d{1,2}))?")


def _exponents(term: str) -> tuple[int, ...]:
    """Parse a term: the exponents of U, s, |s|, dp, |dp|, T, nu."""
    exponents = dict.fromkeys(polynomial.FACTORS, 0)
    for factor in [] if term == "1" else term.replace(" ", "").split("*"):
        match = _FACTOR.fullmatch(factor)
        if match is None:
            allowed = ", ".join(polynomial.FACTORS)
            raise ConfigurationError(
                f"polynomial: term {term!r}: {factor!r} is none of 1, {allowed} or a power like U^2"
            )
        exponents[match[1]] += int(match[2] or 1)
    return tuple(exponents.values())


def _spell(powers: dict[str, int]) -> str:
    spelt = [name if k == 1 else f"{name}^{k}" for name, k in powers.items() if k]
    return "*".join(spelt) or "1"
