"""The picture of one map: flow over control voltage, a curve per pressure drop."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from valvemap.model.samples import Floats
from valvemap.report.plots import COLOURS


@dataclass(frozen=True)
class Curve:
    """The map at one pressure drop (bar); arrays (N,) over U (%), flows in l/min."""

    dp: float
    U: Floats
    Q: Floats
    lower: Floats
    upper: Floats
    guessed: NDArray[np.bool_]


def draw_model(title: str, curves: Sequence[Curve]) -> Figure:
    """Draw curves with their 95 % intervals; extrapolated parts are dotted."""
    figure = Figure(figsize=(7.5, 4.8), layout="constrained")
    axes = figure.add_subplot()
    for curve, colour in zip(curves, COLOURS, strict=False):
        label = f"{curve.dp:.3g} bar"
        known, guessed = (np.where(x, np.nan, curve.Q) for x in (curve.guessed, ~curve.guessed))
        axes.plot(curve.U, known, color=colour, linewidth=1.6, label=label)
        axes.plot(curve.U, guessed, color=colour, linewidth=1.2, linestyle=":")
        axes.fill_between(curve.U, curve.lower, curve.upper, color=colour, alpha=0.15, linewidth=0)
    axes.grid(visible=True, color="#dddddd", linewidth=0.6)
    axes.set(xlabel="U, %", ylabel="Q, l/min", title=title)
    flows = np.concatenate([curve.Q[np.isfinite(curve.Q)] for curve in curves])
    if len(flows):
        span = float(np.ptp(flows)) or 1.0
        axes.set_ylim(float(flows.min()) - 0.1 * span, float(flows.max()) + 0.1 * span)
    axes.legend(title="p1 - p2; dotted: extrapolated", fontsize=9)
    return figure
