"""The paper's Figures 4, 7, 8 and 9: the valve's curves, and the measured data."""

import numpy as np

from paper.data import PaperData, Points
from paper.picture import (
    BLUE,
    GREEN,
    ORANGE,
    Picture,
    canvas,
    legend,
    numbers,
    png_of,
    quiet,
)
from valvemap.model.samples import Samples
from valvemap.report.plots import GREY

_SHOWN_S = 30.0


def figure_4(data: PaperData) -> Picture:
    """Draw flow over pressure drop, one curve for each level of U."""
    figure = canvas(8.5, 5.0)
    axes = quiet(figure.subplots())
    measured = data.structured
    axes.plot(measured.dp, measured.Q, ".", color="#b5b5b5", markersize=2.5, label="measured")
    drawn = {"measured": numbers(U=measured.U, dp=measured.dp, Q=measured.Q)}
    for level in data.levels:
        curve = data.curves[level == data.curves.U]
        drawn[f"U = {level:g} %"] = numbers(dp=curve.dp, Q=curve.Q)
        axes.plot(
            curve.dp, curve.Q, color=BLUE, linewidth=1.3, label="simulated" if not level else None
        )
        last = np.flatnonzero(np.isfinite(curve.Q))[-1]
        axes.annotate(
            f"{level:g} %",
            (curve.dp[last], curve.Q[last]),
            xytext=(0, 7),
            textcoords="offset points",
            fontsize=8,
            color=BLUE,
            horizontalalignment="center",
        )
    axes.set(xlabel="pressure drop Δp, bar", ylabel="flow Q, l/min", xlim=(0, 210), ylim=(-9, 218))
    legend(axes, "upper left")
    return Picture(
        "figure-4",
        "Figure 4: flow over pressure drop at different control voltages",
        "Grey: the structured recording, as the sensors show it. Blue: the valve's own curves "
        "without noise, each labelled with its U; they end where the pump's limit ends them.",
        png_of(figure),
        drawn,
    )


def figure_7(data: PaperData) -> Picture:
    """Draw the structured data."""
    return _process(
        "figure-7",
        "Figure 7: structured data",
        "U in steps; at each step p₂ is swept down and up. Right: which points of the map that "
        "reaches.",
        data.structured,
        data.rate_hz,
    )


def figure_8(data: PaperData) -> Picture:
    """Draw the scattered data."""
    return _process(
        "figure-8",
        "Figure 8: scattered data",
        f"A new point of the map with every sample; the first {_SHOWN_S:g} s of the recording. "
        "Right: all of it.",
        data.scattered,
        data.rate_hz,
        shown_s=_SHOWN_S,
    )


def figure_9(data: PaperData) -> Picture:
    """Draw the verification points."""
    truth: Points = data.new
    samples = Samples.of(np.arange(len(truth)), truth.U, truth.dp, 0 * truth.dp, truth.Q)
    return _process(
        "figure-9",
        "Figure 9: data to verify",
        f"{len(truth)} points that are in neither recording, evenly spread over what the bench can "
        f"reach, without noise; the first {_SHOWN_S:g} s. Every error in this report is taken over "
        "these points, unless it says otherwise.",
        samples,
        data.rate_hz,
        shown_s=_SHOWN_S,
    )


def _process(
    key: str,
    title: str,
    caption: str,
    samples: Samples,
    rate_hz: float,
    shown_s: float = np.inf,
) -> Picture:
    seconds = np.arange(len(samples)) / rate_hz
    early = seconds <= shown_s
    figure = canvas(11.0, 4.6)
    grid = figure.add_gridspec(3, 2, width_ratios=(2.1, 1.0))
    rows = (
        ("U, %", samples.U, BLUE),
        ("Δp, bar", samples.dp, GREEN),
        ("Q, l/min", samples.Q, ORANGE),
    )
    for i, (name, column, colour) in enumerate(rows):
        axes = quiet(figure.add_subplot(grid[i, 0]))
        axes.plot(seconds[early], column[early], color=colour, linewidth=0.8)
        axes.set(ylabel=name, xlim=(0, seconds[early][-1]))
        axes.tick_params(labelbottom=i == len(rows) - 1)
        if i == len(rows) - 1:
            axes.set_xlabel("time, s")
    plane = quiet(figure.add_subplot(grid[:, 1]))
    plane.plot(samples.U, samples.dp, ".", color=GREY, markersize=1.8)
    plane.set(xlabel="U, %", ylabel="Δp, bar", xlim=(-3, 103), ylim=(-5, 205))
    drawn = {"samples": numbers(t=seconds, U=samples.U, dp=samples.dp, Q=samples.Q)}
    return Picture(key, title, caption, png_of(figure), drawn)
