"""How the stored states of valves follow a changed configuration: the terms of their review."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from valvemap.model.capabilities import Forgetful, UsesTemperature
from valvemap.model.estimator import StateMismatchError, key_of
from valvemap.pipeline import kept_lanes
from valvemap.pipeline.alignment import Alignment
from valvemap.pipeline.conversion import lane_in_flow_unit, memory_in_units
from valvemap.pipeline.meaning import FLOW, other_scaling, rescaling
from valvemap.pipeline.review import Change
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


_Change = Change[ValvePlan]


class ValveTerms:
    """Implements `Terms`; ``alignment`` is that of the valves' signals."""

    def __init__(self, alignment: Alignment) -> None:
        self._alignment = alignment

    def names(self, rows: Sequence[Checkpoint], plan: ValvePlan) -> Mapping[str, str]:
        """Return the present names of stored estimators that were renamed: settings decide."""
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

    def kept(self, plan: ValvePlan) -> Collection[str]:
        """Return the names of its estimators, and of the states kept beside them."""
        return {*plan.estimators, *BESIDE}

    def is_beside(self, name: str) -> bool:
        """Whether it is none of an estimator."""
        return name in BESIDE

    def as_now(self, own: Checkpoint, change: _Change) -> tuple[Checkpoint, list[str]]:
        """Return a state in the present units, and what changed.

        Raises
        ------
        StateMismatchError
            with the reason in words, if it does not have the present meaning.
        """
        if own.estimator == MEMORY:
            return _memory_as_now(own, change, self._alignment), []
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
        lane = kept_lanes.lane_from_bytes(own.state, estimator, own.lam, frozen=own.frozen, t=own.t)
        blank = replace(lane.support, cells=np.zeros_like(lane.support.cells))
        own = replace(own, state=kept_lanes.lane_to_bytes(replace(lane, support=blank), own.key))
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
    lane = kept_lanes.lane_from_bytes(own.state, then, own.lam, frozen=own.frozen, t=own.t)
    said = f"lam was {lam:g}, now {estimator.lam:g}: kept"
    return replace(own, key=key, state=kept_lanes.lane_to_bytes(lane, key)), [said]


def _in_flow_unit(own: Checkpoint, estimator: AnyEstimator, change: _Change) -> Checkpoint:
    of_Q = rescaling(*change.both, "Q")
    why = other_scaling(*change.both, "Q")
    lane = kept_lanes.lane_from_bytes(own.state, estimator, own.lam, frozen=own.frozen, t=own.t)
    if of_Q.offset != 0.0:
        raise StateMismatchError(f"{why}: with an offset there is no exact conversion")
    try:
        converted = lane_in_flow_unit(lane, of_Q.gain)
    except StateMismatchError as error:
        raise StateMismatchError(f"{why}: {error}") from None
    return replace(own, state=kept_lanes.lane_to_bytes(converted, own.key))


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
