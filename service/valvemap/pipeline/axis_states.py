"""Checkpoints of all axes: packed for the store, and restored if the configuration fits."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Final

from valvemap.model.estimator import StateMismatchError
from valvemap.pipeline.arrivals import Arrivals
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_memory import MEMORIES, AxisMemories
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.kept_axes import ALARMS, LEARNT, SEARCHES, WATCH
from valvemap.pipeline.meaning import IDENTITY
from valvemap.pipeline.review import Change, Reviewed, review
from valvemap.pipeline.store_ports import Checkpoint

OF_AXES: Final = frozenset({LEARNT, SEARCHES, WATCH, ALARMS, *MEMORIES})
"""Names of the stored parts of an axis; no estimator of a valve has one of these names."""


class AxisStates:
    """Implements `KeptTogether` for axes.

    Parameters
    ----------
    axes
        The axes.
    arrivals
        Their lines' arrivals, rows 2k and 2k + 1 for axis k.
    fail
        Called with number and error of an axis that cannot be packed.
    """

    is_preview = False

    def __init__(
        self,
        axes: Sequence[Axis],
        arrivals: Arrivals,
        fail: Callable[[int, Exception], None] = lambda _number, _error: None,
    ) -> None:
        self._axes, self._fail, self._changes = axes, fail, 0
        self._numbers = {axis.plan.name: number for number, axis in enumerate(axes)}
        self._memories = AxisMemories(arrivals, {k: axis.key for k, axis in enumerate(axes)})

    @property
    def units(self) -> list[list[int]]:
        """Single axes."""
        return [[number] for number in range(len(self._axes))]

    @property
    def version(self) -> tuple[int, ...]:
        """Number of the changes noted."""
        return (self._changes,)

    def note_change(self) -> None:
        """Note that a state may have changed."""
        self._changes += 1

    def kept(self, numbers: Sequence[int]) -> list[Checkpoint]:
        """Return all states of these axes; each axis is packed at once."""
        found: list[Checkpoint] = []
        for number in numbers:
            axis = self._axes[number]
            beside = dict(self._memories.packed(number, axis.memory))
            found += checkpoints_of(axis, axis.t, {**axis.to_bytes(), **beside})
        return found

    def stop(self, number: int, error: Exception) -> None:
        """Stop an axis that cannot be packed."""
        self._fail(number, error)

    def review(self, stored: Sequence[Checkpoint]) -> Reviewed:
        """Return stored states in the terms of the present configuration."""
        return review(stored, [axis.plan for axis in self._axes], AxisTerms())

    def restore(self, checkpoints: Sequence[Checkpoint]) -> tuple[list[str], dict[str, str]]:
        """Restore those that fit; return their names, and the reasons for the others by name.

        A memory is restored with all its parts, or not at all.
        """
        restored: list[str] = []
        refused: dict[str, str] = {}
        by_owner: dict[str, dict[str, bytes]] = {}
        for one in checkpoints:
            by_owner.setdefault(one.valve, {})[one.estimator] = one.state
        for owner, own in by_owner.items():
            memory = [name for name in own if name in MEMORIES]
            groups = [*([name] for name in own if name not in MEMORIES), memory]
            for group in filter(None, groups):
                names = [f"{owner}.{name}" for name in group]
                try:
                    self._resume(owner, {name: own[name] for name in group})
                except StateMismatchError as error:
                    refused |= dict.fromkeys(names, str(error))
                else:
                    restored += names
        return restored, refused

    def _resume(self, owner: str, parts: Mapping[str, bytes]) -> None:
        number = self._numbers.get(owner)
        if number is None or not parts.keys() <= OF_AXES:
            raise StateMismatchError("no such axis is configured")
        if parts.keys() <= MEMORIES:
            self._axes[number].remember(self._memories.restored(number, parts))
            return
        for name, packed in parts.items():
            self._axes[number].resume(name, packed)

    def replaces(self, one: Checkpoint) -> bool:
        """Whether it is of a configured axis."""
        return one.valve in self._numbers and one.estimator in OF_AXES

    def meaning_of(self, owner: str) -> str | None:
        """Return what an axis' signals mean, as text; None if it is not configured."""
        number = self._numbers.get(owner)
        return None if number is None else _meaning_text(self._axes[number].plan)

    def is_beside(self, name: str) -> bool:
        """Whether it is not the map."""
        return name != LEARNT


def checkpoints_of(axis: Axis, t: int, parts: Mapping[str, bytes]) -> list[Checkpoint]:
    """Return packed parts of an axis, with its newest sample at ``t``, as checkpoints."""
    name, key, meaning = axis.plan.name, axis.key, _meaning_text(axis.plan)
    return [
        Checkpoint(name, part, key, t, state, lam=None, frozen=False, meaning=meaning)
        for part, state in parts.items()
    ]


def _meaning_text(plan: AxisPlan) -> str:
    return "" if plan.meaning is None else plan.meaning.to_text()


class AxisTerms:
    """Implements `Terms` for axes: their states are not converted."""

    def names(self, _rows: Sequence[Checkpoint], _plan: AxisPlan) -> Mapping[str, str]:
        """Return nothing: the parts of an axis have fixed names."""
        return {}

    def kept(self, _plan: AxisPlan) -> Collection[str]:
        """Return the names of all parts."""
        return OF_AXES

    def is_beside(self, name: str) -> bool:
        """Whether it is not the map."""
        return name != LEARNT

    def as_now(self, own: Checkpoint, change: Change[AxisPlan]) -> tuple[Checkpoint, list[str]]:
        """Return a state of the same nodes and units.

        Raises
        ------
        StateMismatchError
            naming a signal of another node, or in another unit.
        """
        if change.before is None:
            return own, []
        before, now = change.both
        names: tuple[str, ...] = IDENTITY
        if own.estimator in MEMORIES:
            names = tuple(sorted({*before.signals, *now.signals}))
        elif change.T_is_other:
            names = (*IDENTITY, "T")
        change.check_nodes(names)
        change.check_scaling((*names, "T"))
        return own, change.said()
