"""The paper's Tables 1 and 2: 45° plots and the convergence of the parameters."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from paper.data import Points
from paper.evidence import Evidence
from paper.learning import (
    SHOWN,
    USELESS,
    Course,
    Lessons,
    checkpoints,
    learnt,
)
from paper.picture import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PINK,
    SKY,
    VERMILION,
    Picture,
    canvas,
    label,
    numbers,
    png_of,
    quiet,
)
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.model_structures import FiveTerms
from valvemap.model.samples import Floats, Samples
from valvemap.report.plots import GREY

_A = (BLUE, VERMILION, GREEN, PINK, ORANGE)
_U, _DP = 50.0, 100.0
_MIDDLE = FiveTerms().regressors(np.array([_U]), np.array([_DP]), np.array([40.0]))[0]


@dataclass(frozen=True)
class _Column:
    """One method: its final map, its parameters (K, n) over samples (K,), its course."""

    name: str
    Q_hat: Floats
    after: NDArray[np.int64]
    theta: Floats
    names: tuple[str, ...]
    course: Course
    is_linear: bool = True


def table_1(evidence: Evidence) -> Picture:
    """Draw structured data: RLS with several λ, and the RBF network."""
    data, known, network = evidence.data, evidence.structured, evidence.network
    truth = data.new
    state = learnt(network, data.structured)
    m = network.grid[0] * network.grid[1]
    rbf = _Column(
        "RBF network",
        network.predict(state, truth.U, truth.dp, truth.T)[0],
        known.rbf.after,
        known.rbf_theta[:, :m],
        (),
        known.rbf,
        is_linear=False,
    )
    return _table(
        "table-1",
        "Table 1: verification of RLS and the RBF network with structured data",
        [*_rls(known, data.structured, truth), rbf],
        known.lsm,
        truth,
        data.structured,
    )


def table_2(evidence: Evidence) -> Picture:
    """Draw scattered data: RLS with several λ, and RML."""
    data, known = evidence.data, evidence.scattered
    truth, rml = data.new, MaximumLikelihood()
    state = learnt(rml, data.scattered)
    column = _Column(
        "RML",
        rml.predict(state, truth.U, truth.dp, truth.T)[0],
        known.rml.after,
        known.rml_theta[:, :5],
        FiveTerms().parameter_names,
        known.rml,
    )
    return _table(
        "table-2",
        "Table 2: verification of RLS and RML with scattered data",
        [*_rls(known, data.scattered, truth), column],
        known.lsm,
        truth,
        data.scattered,
    )


def _rls(known: Lessons, samples: Samples, truth: Points) -> list[_Column]:
    X = FiveTerms().regressors(truth.U, truth.dp, truth.T)
    after = checkpoints(len(samples))
    return [
        _Column(
            f"RLS, λ = {lam:g}",
            X @ known.theta[lam][-1],
            after,
            known.theta[lam][after - 1],
            FiveTerms().parameter_names,
            known.rls[lam],
        )
        for lam in SHOWN
    ]


def _table(
    key: str,
    title: str,
    columns: list[_Column],
    lsm: Floats,
    truth: Points,
    samples: Samples,
) -> Picture:
    figure = canvas(2.75 * len(columns), 7.6)
    panels = figure.subplots(3, len(columns))
    drawn: dict[str, Mapping[str, list[float | None]]] = {}
    for i, column in enumerate(columns):
        top, middle, bottom = (quiet(axes) for axes in panels[:, i])
        _agreement(top, column, truth)
        if column.is_linear:
            _parameters(middle, column, lsm)
            middle.tick_params(labelleft=i == 0)
        else:
            _weights(middle, column)
        _course(bottom, column.course)
        top.tick_params(labelleft=i == 0)
        bottom.tick_params(labelleft=i == 0)
        if i == 0:
            top.set_ylabel("identified Q_M, l/min")
            middle.set_ylabel("(a_i − LSM)·X_i, l/min")
            bottom.set_ylabel("error of the map, l/min")
        drawn[column.name] = {
            **numbers(after=column.course.after, rmse=column.course.rmse),
            **numbers(true_Q=truth.Q, identified_Q=column.Q_hat),
            **numbers(**{f"theta_{k}": column.theta[:, k] for k in range(column.theta.shape[1])}),
        }
    handles, names = panels[1, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=5, fontsize=9, frameon=False)
    return Picture(
        key,
        title,
        f"Top: identified over true flow at the {len(truth)} points of Figure 9, with the last "
        f"parameters; ideal is the 45° line. Middle: how far each term of eq. (7) is, at "
        f"U = {_U:g} %, Δp = {_DP:g} bar, from what batch least squares finds in all "
        f"{len(samples):,} samples, while they come in; 0 is ideal (of the network: its weights). "
        "Bottom: error of the map over the same samples, RMSE in l/min; dashed: "
        f"{USELESS:g} l/min, above which a map is of no use; grey: the last third of the run, "
        "by which convergence is judged.",
        png_of(figure),
        drawn,
    )


def _agreement(axes: Axes, column: _Column, truth: Points) -> None:
    low, high = -25.0, 225.0
    axes.plot([low, high], [low, high], color=VERMILION, linewidth=0.9)
    axes.plot(truth.Q, column.Q_hat, ".", color=BLUE, markersize=2, alpha=0.6)
    axes.set(xlim=(low, high), ylim=(low, high), aspect="equal", xlabel="true Q_P, l/min")
    axes.set_title(column.name, fontsize=10)
    error = float(np.sqrt(np.mean((column.Q_hat - truth.Q) ** 2)))
    outside = int(np.sum((column.Q_hat < low) | (column.Q_hat > high)))
    label(axes, f"RMSE {error:.3g} l/min" + (f"\n{outside} points outside" if outside else ""))


def _parameters(axes: Axes, column: _Column, lsm: Floats) -> None:
    for k, (name, colour) in enumerate(zip(column.names, _A, strict=True)):
        share = (column.theta[:, k] - lsm[k]) * _MIDDLE[k]
        axes.plot(column.after, share, color=colour, linewidth=1.1, label=name)
    axes.set(ylim=(-40, 40), xlim=(0, column.after[-1]), xlabel="samples")


def _weights(axes: Axes, column: _Column) -> None:
    axes.plot(column.after, column.theta, color=SKY, linewidth=0.7)
    axes.set(xlim=(0, column.after[-1]), xlabel="samples")
    axes.set_title("weights w_j, l/min", fontsize=8)


def _course(axes: Axes, course: Course) -> None:
    axes.axvspan(2 / 3 * course.after[-1], course.after[-1], color="#f2f2f2", zorder=0)
    axes.axhline(USELESS, color=GREY, linewidth=0.8, linestyle="--")
    axes.semilogy(course.after, np.clip(course.rmse, 0.3, 1e4), color=BLACK, linewidth=1)
    axes.set(ylim=(1, 1000), xlim=(0, course.after[-1]), xlabel="samples")
    settled = "converged" if course.converged else "not converged"
    label(axes, f"{settled}\nunrest {course.unrest:.2f}", x=0.45)
