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
from valvemap.model.samples import Floats

WINDOW_S: Final = 10.0  # s of used movement
DELAY: Final = 6  # windows, until one joins the reference
REFIT: Final = 6  # windows that join the reference from fit to fit
MOST_WINDOWS: Final = 60  # not yet weighed; what is older is dropped
_LIKELY: Final = 0.5
SUMS: Final = ("M", "b", "squares", "errors", "scores")
"""Of an `AxisState`: what windows add to the reference."""


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
        State of the running window.
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
    sums: AxisState
    running: AxisState
    condition: Condition
    closed: tuple[AxisState, ...] = ()
    waiting: tuple[AxisState, ...] = ()
    joined: int = 0

    @classmethod
    def begin(cls, state: AxisState, found: AxisFit, memory_s: float, of_shape: Floats) -> Self:
        """Return the watch from now on; ``found`` is the fit of ``state`` as its edges are now."""
        return cls(
            replace(found.regression, memory_s=math.inf, changes_per_s=0.0),
            memory_s,
            of_shape,
            Reference.of(found),
            with_moved_sums(state),
            _empty(with_theta(state, found.theta)),
            Condition.initial(),
        )

    def after(self, samples: AxisSamples) -> "AxisWatch":
        """Return the watch after samples with movement; a window ends with a batch."""
        running, _ = self.regression.update(self.running, samples)
        if running.squares[2] * self.regression.row_s < WINDOW_S:
            return replace(self, running=running)
        closed = (*self.closed, running)[-MOST_WINDOWS:]
        return replace(self, running=_empty(running), closed=closed)

    def weighed(self) -> "AxisWatch":
        """Return the watch with all closed windows weighed."""
        watch = self
        for window in self.closed:
            watch = watch._with(window)
        return replace(watch, closed=())

    def _with(self, window: AxisState) -> "AxisWatch":
        seconds = float(window.squares[2]) * self.regression.row_s
        condition = self.condition.after(self.reference, WindowSums.of(window), seconds)
        if condition.unchanged < _LIKELY:
            return replace(self, condition=condition, waiting=())
        waiting = (*self.waiting, window)
        if len(waiting) <= DELAY:
            return replace(self, condition=condition, waiting=waiting)
        sums = _joined(self.sums, waiting[0], math.exp(-seconds / self.memory_s))
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
        running = with_theta(self.running, weighed.reference.theta)
        return replace(weighed, running=running, closed=since)


def _refitted(watch: AxisWatch) -> AxisWatch:
    found = fit(watch.regression, watch.sums)
    found = replace(found, covariance=found.covariance + watch.of_shape)
    return replace(watch, reference=Reference.of(found), joined=0)


def _empty(state: AxisState) -> AxisState:
    """Return the state with its filters, and no rows."""
    names = (*SUMS, "score")
    return replace(state, **{name: np.zeros_like(getattr(state, name)) for name in names})


def _joined(sums: AxisState, window: AxisState, keep: float) -> AxisState:
    return replace(
        sums, **{name: keep * getattr(sums, name) + getattr(window, name) for name in SUMS}
    )
