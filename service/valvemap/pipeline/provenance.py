"""Compares the meaning of stored states with the present configuration, before they are restored.

By the meaning of its signals, a state is restored as it is, converted, found under another name, or
set aside: it is never restored under a meaning other than its own.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from valvemap.model.capabilities import Forgetful, UsesTemperature
from valvemap.model.estimator import StateMismatchError, key_of
from valvemap.pipeline import valve_state
from valvemap.pipeline.alignment import Alignment
from valvemap.pipeline.conversion import lane_in_flow_unit, memory_in_units
from valvemap.pipeline.meaning import (
    FLOW,
    UNREADABLE,
    Meaning,
    digest_of,
    other_accuracies,
    other_nodes,
    other_scaling,
    rescaling,
)
from valvemap.pipeline.store_ports import Checkpoint
from valvemap.pipeline.valve_memory import ValveMemory
from valvemap.pipeline.valve_state import AnyEstimator, ValvePlan
from valvemap.vocabulary.signals import MEASURED, READ

MEMORY: Final = "Diagnostics"  # a valve's state beside its estimators; no estimator has this name
TIMING: Final = "Signals"  # how its signals are stamped; likewise
BASELINE: Final = "Baseline"  # its approved map; likewise
ALARMS: Final = "Alarms"  # the state of its alarms; likewise
PLACES: Final = "Recommended"  # the errors of its estimators' maps at places; likewise
EDGE: Final = "Edge"  # what waits of an edge of a valve with ports; likewise
METER: Final = "Meter"  # the state of a valve behind a shared meter; likewise
DYNAMICS: Final = "Dynamics"  # what its dynamics are compared with; likewise
BESIDE: Final = (MEMORY, TIMING, BASELINE, ALARMS, PLACES, EDGE, METER, DYNAMICS)


@dataclass(frozen=True)
class Aside:
    """A stored state that is not restored, and why."""

    checkpoint: Checkpoint
    reason: str


@dataclass
class Reviewed:
    """Stored states in the terms of the present configuration.

    Attributes
    ----------
    checkpoints
        The states to restore, under their present names and in the present units.
    aside
        The states to keep apart, as they were stored.
    changes
        What changed with the states that are restored: a sentence by ``<Valve>.<Estimator>``.
    moved
        (valve, estimator) as stored, by what they are now: the rows to delete.
    """

    checkpoints: list[Checkpoint] = field(default_factory=list)
    aside: list[Aside] = field(default_factory=list)
    changes: dict[str, str] = field(default_factory=dict)
    moved: dict[tuple[str, str], tuple[str, str]] = field(default_factory=dict)

    @property
    def set_aside(self) -> dict[str, str]:
        """The reasons by ``<Valve>.<Estimator>`` as stored."""
        return {
            f"{one.checkpoint.valve}.{one.checkpoint.estimator}": one.reason for one in self.aside
        }


def review(
    stored: Sequence[Checkpoint], plans: Sequence[ValvePlan], alignment: Alignment
) -> Reviewed:
    """Return the stored states in the terms of the present configuration."""
    found = Reviewed()
    by_valve: dict[str, list[Checkpoint]] = {}
    for one in stored:
        by_valve.setdefault(one.valve, []).append(one)
    successors = _successors(by_valve, plans)
    named = {plan.name: plan for plan in plans}
    replaced = set(successors.values())
    for name, rows in by_valve.items():
        new = successors.get(name)
        if new is not None:
            _review_valve(rows, named[new], _homes(plans), alignment, found)
        elif name in replaced and name in named:
            found.aside += [
                Aside(row, f"{name} now has the nodes of another valve") for row in rows
            ]
        else:
            found.checkpoints += rows  # of the service, or of no configured valve
    return found


def _homes(plans: Sequence[ValvePlan]) -> set[str]:
    """Return the configured sources."""
    return {plan.meaning.source for plan in plans if plan.meaning is not None}


def _successors(
    by_valve: Mapping[str, list[Checkpoint]], plans: Sequence[ValvePlan]
) -> dict[str, str]:
    """Return the present name of each stored valve that is configured: the nodes decide."""
    homes, names = _homes(plans), {plan.name for plan in plans}
    meanings = {name: _newest_meaning(rows) for name, rows in by_valve.items()}
    found: dict[str, str] = {}
    for plan in plans:
        meaning, own = plan.meaning, meanings.get(plan.name)
        if plan.name in by_valve and (meaning is None or own is None or _same(own, meaning, homes)):
            found[plan.name] = plan.name
    for plan in plans:
        if plan.meaning is None or plan.name in found.values():
            continue
        others = [
            name
            for name, meaning in meanings.items()
            if name not in found and meaning is not None and _same(meaning, plan.meaning, homes)
        ]
        if others:
            newest = max(others, key=lambda name: max(row.t for row in by_valve[name]))
            found[newest] = plan.name
    taken = set(found.values())
    for name in by_valve:
        if name in names and name not in found and name not in taken:
            found[name] = name
    return found


def _newest_meaning(rows: Iterable[Checkpoint]) -> Meaning | None:
    known = [(row.t, Meaning.from_text(row.meaning)) for row in rows]
    said = [(t, meaning) for t, meaning in known if meaning is not None]
    return max(said, key=lambda one: one[0])[1] if said else None


def _same(before: Meaning, now: Meaning, homes: set[str]) -> bool:
    """Whether both have the same nodes of one source, which may have moved to another address."""
    return before.nodes == now.nodes and _same_source(before, now, homes)


def _same_source(before: Meaning, now: Meaning, homes: set[str]) -> bool:
    return before.source == now.source or before.source not in homes


def _review_valve(
    rows: Sequence[Checkpoint],
    plan: ValvePlan,
    homes: set[str],
    alignment: Alignment,
    found: Reviewed,
) -> None:
    names = _estimator_names(rows, plan)
    for row in rows:
        new = names.get(row.estimator, row.estimator)
        own = replace(row, valve=plan.name, estimator=new)
        try:
            change = _Change(_meaning_of(row, plan), plan, homes)
            own, said = _as_now(own, change, alignment)
        except StateMismatchError as error:
            found.aside.append(Aside(row, str(error)))
            continue
        if plan.meaning is not None and new in {*plan.estimators, *BESIDE}:
            own = replace(own, meaning=plan.meaning.to_text())
        found.checkpoints.append(own)
        was, now = (row.valve, row.estimator), (plan.name, new)
        if was != now:
            found.moved[was] = now
        if new not in BESIDE:
            renamed = [f"was {'.'.join(was)}: found again by its {_by(was, now)}"]
            said = [*(renamed if was != now else []), *said]
            if said:
                found.changes[f"{plan.name}.{new}"] = "; ".join(said)


def _meaning_of(row: Checkpoint, plan: ValvePlan) -> Meaning | None:
    """Return the meaning of a state; None if it is unknown, as in files of older versions.

    Raises
    ------
    StateMismatchError
        if it cannot be read and is not the present one.
    """
    if not row.meaning.startswith(UNREADABLE) or plan.meaning is None:
        return Meaning.from_text(row.meaning)
    if row.meaning != f"{UNREADABLE}{digest_of(plan.meaning.to_text())}":
        raise StateMismatchError("the nodes and units that it was learnt from cannot be read")
    return plan.meaning


def _by(was: tuple[str, str], now: tuple[str, str]) -> str:
    return "nodes" if was[0] != now[0] else "settings"


def _estimator_names(rows: Sequence[Checkpoint], plan: ValvePlan) -> dict[str, str]:
    """Return the present name of each stored estimator that was renamed: its settings decide."""
    stored = {row.estimator for row in rows}
    free = [row for row in rows if row.estimator not in (*plan.estimators, *BESIDE)]
    found: dict[str, str] = {}
    for name, estimator in plan.estimators.items():
        if name in stored:
            continue
        alike = [r for r in free if r.key == key_of(estimator) and r.estimator not in found]
        if alike:
            found[max(alike, key=lambda row: row.t).estimator] = name
    return found


class _Change:
    """How the meaning of a valve's signals differs from that of a stored state."""

    def __init__(self, before: Meaning | None, plan: ValvePlan, homes: set[str]) -> None:
        now = plan.meaning
        self.before = before if before is not None and now is not None else None
        self.now = now
        self.plan = plan
        self._homes = homes

    @property
    def both(self) -> tuple[Meaning, Meaning]:
        assert self.before is not None  # noqa: S101 - callers check
        assert self.now is not None  # noqa: S101
        return self.before, self.now

    def check_nodes(self, names: tuple[str, ...] = FLOW) -> None:
        """Reject a state of another source or of other nodes."""
        before, now = self.both
        if not _same_source(before, now, self._homes):
            raise StateMismatchError(f"its source was {before.source}, now {now.source}")
        other = other_nodes(before, now, names)
        if other is not None:
            raise StateMismatchError(other)

    def rescaled(self, names: Iterable[str]) -> list[str]:
        """Return the given signals whose unit or scaling changed."""
        return [name for name in names if not rescaling(*self.both, name).is_none]

    def check_scaling(self, names: Iterable[str]) -> None:
        """Reject a state in other units."""
        for name in self.rescaled(names):
            raise StateMismatchError(other_scaling(*self.both, name))

    @property
    def same_drop(self) -> bool:
        """Whether p1 - p2 is unchanged, because both are shifted alike."""
        p1, p2 = (rescaling(*self.both, name) for name in ("p1", "p2"))
        return p1 == p2 and p1.gain == 1.0

    @property
    def T_is_other(self) -> bool:
        """Whether T comes from another node; a sensor that was added or removed is none."""
        before, now = (meaning.node("T") for meaning in self.both)
        return None not in (before, now) and before != now

    @property
    def T_differs(self) -> bool:
        """Whether temperatures before and now cannot be compared."""
        return self.T_is_other or bool(self.rescaled(("T",)))

    def said(self) -> list[str]:
        """Changes that leave a map valid, in words."""
        before, now = self.both
        found = [
            f"{text}: the map is kept, intervals follow" for text in other_accuracies(*self.both)
        ]
        if self.rescaled(("p1",)) and self.same_drop:
            found.append("p1 and p2 are shifted alike: kept")
        if before.source != now.source:
            found.append(
                f"its source was {before.source}, now {now.source}: kept; if that is another "
                "plant, call Reset"
            )
        return found


def _as_now(own: Checkpoint, change: _Change, alignment: Alignment) -> tuple[Checkpoint, list[str]]:
    """Return a state in the present units, and what changed.

    Raises
    ------
    StateMismatchError
        with the reason in words, if it does not have the present meaning.
    """
    if own.estimator == MEMORY:
        return _memory_as_now(own, change, alignment), []
    if own.estimator in BESIDE:
        if change.before is not None:
            names = READ if own.estimator == TIMING else FLOW
            change.check_nodes(names)
            change.check_scaling(MEASURED if own.estimator == TIMING else FLOW)
        return own, []
    estimator = change.plan.estimators.get(own.estimator)
    if estimator is None:
        return own, []  # not configured; it stays in the file
    return _lane_as_now(own, estimator, change)


def _lane_as_now(
    own: Checkpoint, estimator: AnyEstimator, change: _Change
) -> tuple[Checkpoint, list[str]]:
    own, said = _with_present_lam(own, estimator, change)
    if change.before is None:
        return own, said
    change.check_nodes()
    if isinstance(estimator, UsesTemperature) and estimator.uses_temperature:
        if change.T_is_other:
            change.check_nodes(("T",))
        change.check_scaling(("T",))
    change.check_scaling(("U",))
    if not change.same_drop:
        change.check_scaling(("p1", "p2"))
    if change.rescaled(("Q",)):
        own = _in_flow_unit(own, estimator, change)
        said.append(f"{other_scaling(*change.both, 'Q')}: converted")
    if change.T_differs:
        lane = valve_state.lane_from_bytes(
            own.state, estimator, own.lam, frozen=own.frozen, t=own.t
        )
        blank = replace(lane.support, cells=np.zeros_like(lane.support.cells))
        own = replace(own, state=valve_state.lane_to_bytes(replace(lane, support=blank), own.key))
        said.append("T is another or in another unit: the region of its samples begins empty")
    return own, [*said, *change.said()]


def _with_present_lam(
    own: Checkpoint, estimator: AnyEstimator, change: _Change
) -> tuple[Checkpoint, list[str]]:
    """Bind a state to another configured λ, for which it is valid, too."""
    key = key_of(estimator)
    lam = None if change.before is None else change.before.lam.get(own.estimator)
    if own.key == key or lam is None or not isinstance(estimator, Forgetful):
        return own, []
    try:
        then = estimator.with_forgetting(lam)
    except ValueError:
        return own, []
    if key_of(then) != own.key:
        return own, []
    lane = valve_state.lane_from_bytes(own.state, then, own.lam, frozen=own.frozen, t=own.t)
    said = f"lam was {lam:g}, now {estimator.lam:g}: kept"
    return replace(own, key=key, state=valve_state.lane_to_bytes(lane, key)), [said]


def _in_flow_unit(own: Checkpoint, estimator: AnyEstimator, change: _Change) -> Checkpoint:
    of_Q = rescaling(*change.both, "Q")
    why = other_scaling(*change.both, "Q")
    lane = valve_state.lane_from_bytes(own.state, estimator, own.lam, frozen=own.frozen, t=own.t)
    if of_Q.offset != 0.0:
        raise StateMismatchError(f"{why}: with an offset there is no exact conversion")
    try:
        converted = lane_in_flow_unit(lane, of_Q.gain)
    except StateMismatchError as error:
        raise StateMismatchError(f"{why}: {error}") from None
    return replace(own, state=valve_state.lane_to_bytes(converted, own.key))


def _memory_as_now(own: Checkpoint, change: _Change, alignment: Alignment) -> Checkpoint:
    """Return the samples in the reorder buffer, and the last values, in the present units."""
    if change.before is None:
        return own
    change.check_nodes(READ)
    changed = [rescaling(*change.both, name) for name in MEASURED]
    if all(one.is_none for one in changed):
        return own
    memory = ValveMemory.from_bytes(own.state, own.key, change.plan.gate, alignment)
    factor = changed[MEASURED.index("Q")].gain
    return replace(own, state=memory_in_units(memory, changed, factor).to_bytes(own.key))
