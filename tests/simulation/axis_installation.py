"""How the simulated axis is configured, and the edits of its configuration between two lives."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from valvemap.model.axis import AxisGeometry, AxisRegression
from valvemap.model.axis_basis import SIZE
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.kept_axes import LEARNT, Learnt
from valvemap.pipeline.meaning import Meaning, SignalMeaning

AXIS_EDITS: Final = ("axis name", "axis node", "axis unit", "axis piston", "axis memory")
_SIGNALS: Final = ("U", "position", "pA", "pB", "pS", "pT")


@dataclass(frozen=True)
class InstalledAxis:
    """The configuration of the axis."""

    name: str = "Press"
    node: int = 0
    unit: float = 1.0
    piston_mm: float = 63.0
    memory_s: float = 1_800.0

    @property
    def plan(self):
        """The plan of an axis."""
        signals = {name: SignalMeaning(f"{name}.{self.node}", gain=self.unit) for name in _SIGNALS}
        return AxisPlan(
            self.name,
            AxisGeometry(self.piston_mm, 45, 800, 1.2, 1.2),
            self.memory_s,
            Meaning("opc.tcp://plant", signals),
        )


def first_state(plan, period_s):
    """A packed map that nothing was learnt for: with it, an axis learns from its first sample."""
    axis = Axis(plan)
    regression = AxisRegression(plan.geometry, period_s=period_s, play_percent=2.0)
    axis.learner.continue_from(
        Learnt(regression, regression.initial_state(), np.zeros((SIZE, SIZE)))
    )
    return axis.to_bytes()[LEARNT]


def edited_axis(one, kind):
    """The configuration after an edit; each undoes the one before it of its kind, but for nodes."""
    match kind:
        case "axis name":
            return replace(one, name="Ram" if one.name == "Press" else "Press")
        case "axis node":
            return replace(one, node=one.node + 1)
        case "axis unit":
            return replace(one, unit=1.5 - one.unit)
        case "axis piston":
            return replace(one, piston_mm=127.0 - one.piston_mm)
        case "axis memory":
            return replace(one, memory_s=2_700.0 - one.memory_s)
        case _:
            raise ValueError(kind)


def relived(parts, take):
    """The axis that lived through successive (plan, its first map, samples) without a disturbance.

    ``take`` gives samples to an axis. A part without a map continues with that of the part before.
    """
    axis = None
    for plan, first, samples in parts:
        before, axis = axis, Axis(plan)
        axis.resume(LEARNT, first or before.to_bytes()[LEARNT])
        if not first:
            axis.remember(before.memory)
        take(axis, samples)
    return axis
