"""The states of all valves, or of all axes, as keeper, start and `valvemap state` use them."""

from collections.abc import Sequence
from typing import Protocol

from valvemap.pipeline.identification import Identification
from valvemap.pipeline.lane_failures import Step
from valvemap.pipeline.provenance import BESIDE
from valvemap.pipeline.review import Reviewed
from valvemap.pipeline.store_ports import Checkpoint


class KeptTogether(Protocol):
    """The states in one file; a state's owner is a valve or an axis, by its number."""

    @property
    def units(self) -> Sequence[Sequence[int]]:
        """All owners' numbers; those of a unit are saved together: their samples meet."""

    @property
    def is_preview(self) -> bool:
        """Whether estimators wait: states saved now, and the position, would lose their samples."""

    @property
    def version(self) -> tuple[int, ...]:
        """Equal as long as all states are; a state that is saved in this version is not again.

        How long an alarm has lasted is no change.
        """

    def kept(self, numbers: Sequence[int]) -> list[Checkpoint]:
        """Return all states of these owners."""

    def stop(self, number: int, error: Exception) -> None:
        """Stop an owner whose states cannot be packed."""

    def review(self, stored: Sequence[Checkpoint]) -> Reviewed:
        """Return stored states in the terms of the present configuration."""

    def restore(self, checkpoints: Sequence[Checkpoint]) -> tuple[list[str], dict[str, str]]:
        """Restore those that fit; return their names, and the reasons for the others by name."""

    def replaces(self, one: Checkpoint) -> bool:
        """Whether the next save replaces a state of this name."""

    def meaning_of(self, owner: str) -> str | None:
        """Return what an owner's signals mean, as text; None if it is not configured."""

    def is_beside(self, name: str) -> bool:
        """Whether a state of this name goes with another one, and is not listed."""


class KeptValves:
    """Implements `KeptTogether` for the valves of an identification."""

    def __init__(self, identification: Identification) -> None:
        self._identification = identification
        self._plans = {plan.name: plan for plan in identification.plans}

    @property
    def units(self) -> list[list[int]]:
        """The line and the edges of one valve, the valves behind one meter; else single valves."""
        found: dict[str, list[int]] = {}
        for number, plan in enumerate(self._identification.plans):
            ports = "" if plan.part is None else f"ports {plan.part.valve}"
            meter = f"meter {plan.meter}" if plan.meter else ""
            found.setdefault(ports or meter or f"valve {number}", []).append(number)
        return list(found.values())

    @property
    def together(self) -> list[list[str]]:
        """The names of the valves of each unit."""
        plans = self._identification.plans
        return [[plans[number].name for number in unit] for unit in self.units]

    @property
    def is_preview(self) -> bool:
        """Whether estimators wait for their kernels."""
        return self._identification.journal is not None

    @property
    def version(self) -> tuple[int, ...]:
        """That of the identification."""
        return self._identification.version

    def kept(self, numbers: Sequence[int]) -> list[Checkpoint]:
        """Return all states of these valves."""
        return self._identification.states.kept(numbers)

    def stop(self, number: int, error: Exception) -> None:
        """Stop the lane that failed."""
        self._identification.stop(number, Step.CHECKPOINT, error)

    def review(self, stored: Sequence[Checkpoint]) -> Reviewed:
        """Return stored states in the terms of the present configuration."""
        return self._identification.states.review(stored)

    def restore(self, checkpoints: Sequence[Checkpoint]) -> tuple[list[str], dict[str, str]]:
        """Restore those that fit; return their names, and the reasons for the others by name."""
        return self._identification.restore(checkpoints)

    def replaces(self, one: Checkpoint) -> bool:
        """Whether it is of a configured estimator, or kept beside one."""
        plan = self._plans.get(one.valve)
        return plan is not None and one.estimator in (*plan.estimators, *BESIDE)

    def meaning_of(self, owner: str) -> str | None:
        """Return what a valve's signals mean, as text; None if it is not configured."""
        plan = self._plans.get(owner)
        return None if plan is None or plan.meaning is None else plan.meaning.to_text()

    def is_beside(self, name: str) -> bool:
        """Whether it is none of an estimator."""
        return name in BESIDE
