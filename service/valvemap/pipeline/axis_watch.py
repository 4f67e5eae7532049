"""Watches an axis for changes: windows of its samples against a reference that follows slow drift.

The reference begins as the map when play and spool are settled. A window joins it a minute later,
if nothing has changed until then: what changes suddenly is found before the reference follows it.
"""

import math
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from valvemap.model.axis import AxisRegression, AxisSamples, AxisState
from valvemap.model.axis_condition import Condition, Reference, WindowSums
from valvemap.model.axis_fit import AxisFit, fit, with_moved_sums, with_theta
from valvemap.model.axis_force import ForceReference, ForceState
from valvemap.model.samples import Floats

Balance = tuple[ForceReference, ForceState]
"""The balance of forces as it was, and the sums behind it."""
WINDOW_S: Final = 10.0  # s of used movement
DELAY: Final = 6  # windows, until one joins the reference
REFIT: Final = 6  # windows that join the reference from fit to fit
MOST_WINDOWS: Final = 60  # not yet weighed; older ones are dropped
_LIKELY: Final = 0.5
SUMS: Final = ("M", "b", "squares", "errors", "scores")
"""Of an `AxisState`: what windows add to the reference."""


@dataclass(frozen=True)
class AxisWindowSums:
    """What a window has summed: the rows of flow, and those of the balance of forces."""

    flow: AxisState
    force: ForceState

    def emptied(self) -> "AxisWindowSums":
        """Return these with their filters, and no rows."""
        return AxisWindowSums(_empty(self.flow), self.force.emptied())

    def joined(self, window: "AxisWindowSums", keep: float) -> "AxisWindowSums":
        """Return these sums, of which the share ``keep`` stays, with those of a window."""
        flow = {name: keep * getattr(self.flow, name) + getattr(window.flow, name) for name in SUMS}
        return AxisWindowSums(replace(self.flow, **flow), self.force.joined(window.force, keep))


@dataclass(frozen=True)
class AxisWatch:
    """A value: the reference and its sums, the running window, and windows not yet weighed.

    Attributes
    ----------
    regression
        That of the reference.
    memory_s
        Time constant with which the reference forgets, s of movement.
    of_shape
        Part of the covariance that is due to play and spool, (n, n).
    sums
        Of the reference's rows.
    running
        Those of the running window.
    closed
        Windows not yet weighed.
    waiting
        Weighed windows that have not yet joined the reference.
    joined
        Windows since the last fit of the reference.
    """

    regression: AxisRegression
    memory_s: float
    of_shape: Floats
    reference: Reference
    sums: AxisWindowSums
    running: AxisWindowSums
    condition: Condition
    closed: tuple[AxisWindowSums, ...] = ()
    waiting: tuple[AxisWindowSums, ...] = ()
    joined: int = 0

    @classmethod
    def begin(
        cls,
        state: AxisState,
        found: AxisFit,
        memory_s: float,
        of_shape: Floats,
        force: Balance | None = None,
    ) -> Self:
        """Return the watch from now on; ``found`` is the fit of ``state`` as its edges are now.

        ``force`` is the balance of forces until now (`balance`); None: friction is not watched.
        """
        reference, sums = (None, ForceState.initial()) if force is None else force
        return cls(
            _still(found.regression),
            memory_s,
            of_shape,
            Reference.of(found, reference),
            AxisWindowSums(with_moved_sums(state), sums),
            AxisWindowSums(_empty(with_theta(state, found.theta)), sums.emptied()),
            Condition.initial(),
        )

    def after(self, samples: AxisSamples) -> "AxisWatch":
        """Return the watch after samples with movement; a window ends with a batch."""
        flow, trace = self.regression.update(self.running.flow, samples)
        force, balance = self.running.force, self.reference.force
        if balance is not None:
            force = balance.update(force, samples, np.ascontiguousarray(trace.speed[:, 1]))
        running = AxisWindowSums(flow, force)
        if flow.squares[2] * self.regression.row_s < WINDOW_S:
            return replace(self, running=running)
        closed = (*self.closed, running)[-MOST_WINDOWS:]
        return replace(self, running=running.emptied(), closed=closed)

    def weighed(self) -> "AxisWatch":
        """Return the watch with all closed windows weighed."""
        watch = self
        for window in self.closed:
            watch = watch._with(window)
        return replace(watch, closed=())

    def _with(self, window: AxisWindowSums) -> "AxisWatch":
        seconds = float(window.flow.squares[2]) * self.regression.row_s
        sums_of_window = WindowSums.of(window.flow, window.force)
        condition = self.condition.after(self.reference, sums_of_window, seconds)
        if condition.unchanged < _LIKELY:
            return replace(self, condition=condition, waiting=())
        waiting = (*self.waiting, window)
        if len(waiting) <= DELAY:
            return replace(self, condition=condition, waiting=waiting)
        sums = self.sums.joined(waiting[0], math.exp(-seconds / self.memory_s))
        after = replace(
            self, condition=condition, waiting=waiting[1:], sums=sums, joined=self.joined + 1
        )
        return _refitted(after) if after.joined >= REFIT else after

    def accepted(self, before: "AxisWatch", weighed: "AxisWatch") -> "AxisWatch":
        """Return this watch with the outcome of weighing ``before``, from which it has come.

        The running window, and windows closed since, stay.
        """
        known = {id(window) for window in before.closed}
        since = tuple(window for window in self.closed if id(window) not in known)
        flow = with_theta(self.running.flow, weighed.reference.theta)
        return replace(weighed, running=replace(self.running, flow=flow), closed=since)


def balance(found: AxisFit, samples: AxisSamples) -> Balance | None:
    """Return the balance of forces in samples, and its sums; None: they tell no dry friction."""
    regression = _still(found.regression)
    _, trace = regression.update(with_theta(regression.initial_state(), found.theta), samples)
    speed = np.ascontiguousarray(trace.speed[:, 1])
    known = ForceReference.of(regression.geometry, regression.period_s, samples, speed)
    return None if known is None else (known, known.update(ForceState.initial(), samples, speed))


def _still(regression: AxisRegression) -> AxisRegression:
    """Return the regression that keeps all information and follows no change."""
    return replace(regression, memory_s=math.inf, changes_per_s=0.0)


def _refitted(watch: AxisWatch) -> AxisWatch:
    found = fit(watch.regression, watch.sums.flow)
    found = replace(found, covariance=found.covariance + watch.of_shape)
    force = watch.reference.force
    if force is not None:
        force = force.fitted(watch.sums.force)
    return replace(watch, reference=Reference.of(found, force), joined=0)


def _empty(state: AxisState) -> AxisState:
    """Return the state with its filters, and no rows."""
    names = (*SUMS, "score")
    return replace(state, **{name: np.zeros_like(getattr(state, name)) for name in names})
