"""How the flow map depends on its parameters: Q = X(U, dp, T)ᵀ·theta."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from service.identification.samples import Floats


class Structure(Protocol):
    """A structure that is linear in its parameters; frozen, hashable by its fields."""

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of theta's n elements, as published."""

    def regressors(self, U: Floats, dp: Floats, T: Floats) -> Floats:
        """Rows Xᵀ (N, n) at N points; a row depends on its own point alone, bit for bit."""


@runtime_checkable
class StructureWithPrior(Structure, Protocol):
    """A structure that knows something of its parameters before the first sample.

    An estimator feeds the prior into its initial information as pseudo-samples: row·theta = value,
    each with the weight (noise variance) of one measured sample. They are no samples: neither the
    sample count nor the noise variance may know of them.
    """

    def prior(self) -> tuple[Floats, Floats]:
        """Rows (R, n) and values (R,), l/min."""


@dataclass(frozen=True)
class FiveTerms:
    """The paper's structure, eq. (7): Q = a1 + a2·U + a3·s + a4·U·s + a5·s·|s|, s = √dp.

    With s = sign(dp)·√|dp| (√bar) the flow may change its direction; a5·s·|s| is a5·dp.

    Examples
    --------
    >>> FiveTerms().regressors(np.array([50.0]), np.array([100.0]), np.array([40.0]))
    array([[  1.,  50.,  10., 500., 100.]])
    """

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The paper's names."""
        return ("a1", "a2", "a3", "a4", "a5")

    def regressors(self, U: Floats, dp: Floats, T: Floats) -> Floats:  # noqa: ARG002
        """Rows [1, U, s, U·s, s·|s|] of shape (N, 5)."""
        with np.errstate(all="ignore"):
            s = np.copysign(np.sqrt(np.abs(dp)), dp)
            return np.stack([np.ones_like(U), U, s, U * s, dp], axis=1)
