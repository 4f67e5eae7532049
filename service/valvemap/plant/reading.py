"""What a reading of one valve's signals is: nodes and scales by role, with its probability."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valvemap.plant.candidates import Candidate
from valvemap.plant.law import NOT_TESTED, Fit
from valvemap.plant.roles import Role
from valvemap.plant.scales import Scale

Floats = NDArray[np.float64]

WITH_PRESSURES: Final = (Role.U, Role.P1, Role.P2, Role.Q)
WITH_DIFFERENCE: Final = (Role.U, Role.DP, Role.Q)
_UNWATCHED: Final = np.full(1, np.nan)


@dataclass(frozen=True)
class Record:
    """Values of variables at equal steps, by node; NaN where there is none."""

    values: Mapping[str, Floats] = field(default_factory=dict)
    step_s: float = 0.1

    def of(self, candidate: Candidate) -> Floats:
        """Return the values of a variable; one NaN if it was not watched."""
        return self.values.get(candidate.node, _UNWATCHED)


@dataclass(frozen=True)
class Reading:
    """One reading: nodes and scales by role. ``mistake`` says which label it holds to be wrong.

    ``beside`` are the valves whose flows its meter measures, too; ``contradictions`` what speaks
    against it, in nats, apart from names and law.
    """

    nodes: Mapping[Role, Candidate]
    scales: Mapping[Role, Scale]
    score: float
    fit: Fit = NOT_TESTED
    mistake: str = ""
    values: Mapping[Role, Floats] = field(default_factory=dict, compare=False)
    probability: float = 0.0
    contradictions: Mapping[str, float] = field(default_factory=dict, compare=False)
    prior: float = 0.0
    beside: tuple[str, ...] = ()

    @property
    def missing(self) -> tuple[Role, ...]:
        """Required roles without a node."""
        wanted = WITH_DIFFERENCE if Role.DP in self.nodes else WITH_PRESSURES
        return tuple(role for role in wanted if role not in self.nodes)

    @property
    def key(self) -> tuple[object, ...]:
        """Equal for readings that give the same configuration."""
        signals = (
            (role, self.nodes[role].node, self.scales[role].text) for role in sorted(self.nodes)
        )
        return (*signals, *self.beside)

    @property
    def assumed(self) -> tuple[Role, ...]:
        """Roles whose unit nothing states."""
        return tuple(role for role, scale in self.scales.items() if not scale.stated)


@dataclass(frozen=True)
class Given:
    """Answers for one valve: nodes and scales that are settled; ``ports``: all edges are learnt."""

    nodes: Mapping[Role, str] = field(default_factory=dict)
    scales: Mapping[Role, Scale] = field(default_factory=dict)
    assume: bool = False
    ports: bool = False

    def node_of(self, signal: str) -> str | None:
        """Return the answered node of a signal; a signal without a role has none."""
        return next((node for role, node in self.nodes.items() if role == signal), None)

    def scale_of(self, signal: str) -> Scale | None:
        """Return the answered scale of a signal; a signal without a role has none."""
        return next((scale for role, scale in self.scales.items() if role == signal), None)
