"""Additional pictures: sweep of λ, error of all methods, damage, extrapolation."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes

from paper.claims_map import CORNER
from paper.data import Points, within
from paper.evidence import Evidence
from paper.learning import (
    LAMBDAS,
    PASSES,
    SHOWN,
    USELESS,
    Course,
    Lessons,
    learnt,
    linear_course,
)
from paper.picture import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PINK,
    VERMILION,
    Picture,
    canvas,
    legend,
    numbers,
    png_of,
    quiet,
)
from valvemap.model.least_squares_of_arrays import recursive_least_squares
from valvemap.model.model_structures import FiveTerms
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Floats, Samples
from valvemap.report.plots import GREY

Drawn = dict[str, Mapping[str, list[float | None]]]

_THINNED = (1, 2, 5, 10, 20)
_SHADES = ("#08306b", "#2171b5", "#4292c6", "#6baed6", "#9ecae1")
_LARGEST = 1e4


def sweep(evidence: Evidence, dense: Samples) -> Picture:
    """Draw the unrest over λ; `dense` is a structured recording at a higher rate."""
    figure = canvas(11.0, 4.2)
    left, right = (quiet(axes) for axes in figure.subplots(1, 2))
    drawn: Drawn = {}
    forgets = np.array([1.0 - lam for lam in LAMBDAS])
    places = np.where(forgets > 0.0, forgets, 3e-5)
    both = (
        ("structured", evidence.structured, VERMILION),
        ("scattered", evidence.scattered, BLUE),
    )
    for name, known, colour in both:
        plain = _clipped([known.rls[lam].unrest for lam in LAMBDAS])
        squared = _clipped([known.rls[lam**2].unrest for lam in LAMBDAS])
        left.plot(places, plain, "o-", color=colour, markersize=4, linewidth=1.2, label=name)
        left.plot(
            places,
            squared,
            "x--",
            color=colour,
            markersize=5,
            linewidth=1,
            label=f"{name}, (28) as printed: λ²",
        )
        drawn[name] = numbers(lam=LAMBDAS, unrest=plain, unrest_as_printed=squared)
    left.set(xscale="log", yscale="log", xlabel="1 − λ", ylabel="unrest (converged up to 1)")
    left.set_xticks(places[[0, 1, 2, 3, 4, 6, 7, 9, 10]])
    left.set_xticklabels(
        [f"{f:.4g}" if f else "0" for f in forgets[[0, 1, 2, 3, 4, 6, 7, 9, 10]]], rotation=35
    )
    left.minorticks_off()
    left.set_title("all λ, both kinds of data", fontsize=10)
    _memory(right, evidence, dense, drawn)
    for axes in (left, right):
        axes.axhline(1.0, color=BLACK, linewidth=0.8)
        legend(axes)
    return Picture(
        "lambda-sweep",
        "Sweep of λ and λ²",
        "Unrest is the error that 95 % of the last third of a run stay below, over its limit; the "
        "black line is the border of convergence. Dashed: what λ does if (28) is taken as printed. "
        "Right: one structured recording, thinned, over the memory 1/(1 − λ) in levels of U. One "
        "level alone does not determine eq. (7); where the curves fall onto each other, it is the "
        "number of remembered levels that counts, not λ itself.",
        png_of(figure),
        drawn,
    )


def courses(evidence: Evidence) -> Picture:
    """Draw the error over samples for all methods and both kinds of data."""
    figure = canvas(11.0, 4.2)
    panels = figure.subplots(1, 2, sharey=True)
    drawn: Drawn = {}
    both = (
        ("structured data", panels[0], evidence.structured),
        ("scattered data", panels[1], evidence.scattered),
    )
    for name, axes, known in both:
        for method, course, colour, style in _methods(known):
            quiet(axes).loglog(
                course.after, _clipped(course.rmse), style, color=colour, linewidth=1.1,
                label=method,
            )  # fmt: skip
            drawn[f"{name}, {method}"] = numbers(after=course.after, rmse=course.rmse)
        axes.axhline(USELESS, color=GREY, linewidth=0.8, linestyle="--")
        axes.set(xlabel="samples", ylim=(1, 2000), xlim=(5, None))
        axes.set_title(name, fontsize=10)
    panels[0].set_ylabel("error of the map, l/min")
    legend(panels[0], "lower left")
    return Picture(
        "courses",
        "How fast the methods converge",
        "Error against the truth at the points of Figure 9, after so many samples of one pass. "
        "Dotted: the forms as the paper prints them; a line that leaves the picture at the top is "
        "no longer a number.",
        png_of(figure),
        drawn,
    )


def damage(evidence: Evidence) -> Picture:
    """Draw the error against the damaged valve."""
    figure = canvas(8.5, 3.8)
    axes = quiet(figure.subplots())
    drawn: Drawn = {}
    middle = len(evidence.data.damaged) // 2
    for lam, colour in zip(SHOWN, (BLUE, GREEN, ORANGE, VERMILION), strict=True):
        course = evidence.damage.courses[lam]
        axes.semilogy(
            course.after, _clipped(course.rmse), color=colour, linewidth=1.2, label=f"λ = {lam:g}"
        )
        drawn[f"λ = {lam:g}"] = numbers(after=course.after, rmse=course.rmse)
    axes.axvline(middle, color=GREY, linewidth=0.8, linestyle="--")
    axes.axhline(evidence.damage.fresh, color=GREY, linewidth=0.8)
    axes.text(20, evidence.damage.fresh * 0.72, "a fresh start after it", fontsize=8, color=GREY)
    axes.text(middle + 10, 50, "damage", fontsize=8, color=GREY)
    axes.set(
        xlabel="samples",
        ylabel="error against the\ndamaged valve, l/min",
        ylim=(0.7, 200),
        xlim=(0, len(evidence.data.damaged)),
    )
    legend(axes, "upper left", columns=2)
    return Picture(
        "damage",
        "After an abrupt damage",
        "RLS with eq. (7) on scattered data. Left of the dashed line the valve is as new, so the "
        "error against the damaged valve is what the damage makes; from there on each λ follows as "
        "it can.",
        png_of(figure),
        drawn,
    )


def extrapolation(evidence: Evidence) -> Picture:
    """Draw the error over the map after training in one corner."""
    data, network = evidence.data, evidence.network
    corner = within(data.scattered, *CORNER)
    rls = RecursiveLeastSquares()
    truth = data.new
    errors = {
        "RLS, eq. (7)": rls.predict(learnt(rls, corner), truth.U, truth.dp, truth.T)[0] - truth.Q,
        f"RBF network, {PASSES} passes": network.predict(
            learnt(network, corner, PASSES), truth.U, truth.dp, truth.T
        )[0]
        - truth.Q,
    }
    figure = canvas(9.5, 4.0)
    drawn: Drawn = {}
    for axes, (name, error) in zip(figure.subplots(1, 2, sharey=True), errors.items(), strict=True):
        dots = quiet(axes).scatter(
            truth.U, truth.dp, c=np.clip(np.abs(error), 0.1, 100), s=13, cmap="viridis",
            norm="log", vmin=0.1, vmax=100,
        )  # fmt: skip
        axes.plot([0, CORNER[0], CORNER[0]], [CORNER[1], CORNER[1], 0], color=PINK, linewidth=1.5)
        axes.set(xlabel="U, %", xlim=(0, 100), ylim=(0, 200))
        axes.set_title(name, fontsize=10)
        drawn[name] = numbers(U=truth.U, dp=truth.dp, error=error)
    figure.axes[0].set_ylabel("Δp, bar")
    figure.colorbar(dots, ax=figure.axes, label="|error|, l/min")
    return Picture(
        "extrapolation",
        "Extrapolation",
        f"Both learnt only from scattered data with U ≤ {CORNER[0]:g} % and Δp ≤ {CORNER[1]:g} bar "
        "(inside the pink lines); each dot is a point of Figure 9.",
        png_of(figure),
        drawn,
    )


def _memory(axes: Axes, evidence: Evidence, dense: Samples, drawn: Drawn) -> None:
    truth: Points = evidence.data.new
    structure, levels = FiveTerms(), len(evidence.data.levels)
    XV = structure.regressors(truth.U, truth.dp, truth.T)
    for every, colour in zip(_THINNED, _SHADES, strict=True):
        samples = dense[::every]
        X = structure.regressors(samples.U, samples.dp, samples.T)
        per_level = len(samples) / levels
        lams = [lam for lam in LAMBDAS if lam < 1.0]
        unrest = _clipped(
            [
                linear_course(
                    recursive_least_squares(X, samples.Q, lam).theta_history, XV, truth.Q
                ).unrest
                for lam in lams
            ]
        )
        memory = np.array([1.0 / (1.0 - lam) for lam in lams]) / per_level
        name = f"{per_level:.0f} samples per level"
        axes.plot(memory, unrest, "o-", color=colour, markersize=4, linewidth=1.1, label=name)
        drawn[name] = numbers(lam=lams, memory_in_levels=memory, unrest=unrest)
    axes.set(xscale="log", yscale="log", xlabel="memory 1/(1 − λ), levels of U")
    axes.set_title("structured data, sampled faster and slower", fontsize=10)


def _methods(known: Lessons) -> list[tuple[str, Course, str, str]]:
    return [
        ("RLS, λ = 0.995", known.rls[0.995], ORANGE, "-"),
        ("RLS, λ = 1", known.rls[1.0], VERMILION, "-"),
        ("RML", known.rml, GREEN, "-"),
        ("RML, (29) as printed", known.rml_printed, GREEN, ":"),
        ("RBF network", known.rbf, BLUE, "-"),
        ("RBF network, (37) as printed", known.rbf_printed, BLUE, ":"),
    ]


def _clipped(values: Floats | list[float]) -> Floats:
    """Clip values for a logarithmic axis; infinite ones lie above the picture."""
    return np.clip(np.nan_to_num(np.asarray(values, np.float64), posinf=_LARGEST), 1e-2, _LARGEST)
