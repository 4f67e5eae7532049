"""The evidence for the claims: one set of recordings, and the maps identified from it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from paper.data import PaperData, Points
from paper.learning import (
    LAMBDAS,
    Course,
    Lessons,
    lessons,
    linear_course,
    rmse,
)
from valvemap.model.least_squares import batch_least_squares
from valvemap.model.least_squares_of_arrays import recursive_least_squares
from valvemap.model.model_structures import FiveTerms
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.samples import Samples


@dataclass(frozen=True)
class Damage:
    """Results of eq. (7) when the valve is damaged in the middle of the recording.

    Attributes
    ----------
    fresh : float
        Error of batch least squares of the samples after the damage, l/min.
    courses : {λ: Course}
        Error of RLS against the damaged valve.
    """

    fresh: float
    courses: Mapping[float, Course]

    @classmethod
    def of(cls, samples: Samples, worn: Points) -> Self:
        """Identify from a recording with the damage in its middle."""
        structure, half = FiveTerms(), len(samples) // 2
        X = structure.regressors(samples.U, samples.dp, samples.T)
        XV = structure.regressors(worn.U, worn.dp, worn.T)
        fresh = batch_least_squares(X[half:], samples.Q[half:])
        courses = {
            lam: linear_course(recursive_least_squares(X, samples.Q, lam).theta_history, XV, worn.Q)
            for lam in LAMBDAS
        }
        return cls(rmse(XV @ fresh, worn.Q), courses)

    def end(self, lam: float) -> float:
        """Return the final error relative to that of a fresh start; 1 is ideal."""
        return float(self.courses[lam].rmse[-1]) / self.fresh


@dataclass(frozen=True)
class Evidence:
    """One set of recordings, and the maps identified from it."""

    data: PaperData
    network: RbfNetwork
    structured: Lessons
    scattered: Lessons
    damage: Damage

    @classmethod
    def of(cls, data: PaperData, network: RbfNetwork) -> Self:
        """Identify all maps that more than one claim uses."""
        return cls(
            data=data,
            network=network,
            structured=lessons(data.structured, data.new, network),
            scattered=lessons(data.scattered, data.new, network),
            damage=Damage.of(data.damaged, data.worn),
        )
