"""Figures of answers that a map gives: inverse, intervals, validity, next point, table."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from documentation.figures import valves
from documentation.figures.canvas import (
    CURVES,
    FIRST,
    SAMPLES,
    SECOND,
    TRUTH,
    label,
    legend,
    panels,
)
from valvemap.model.estimator import Estimator
from valvemap.model.extrapolation import trusted
from valvemap.model.flow_map import FlowMap
from valvemap.model.inverse_map import invert
from valvemap.model.least_squares_of_arrays import recursive_least_squares as rls_of_rows
from valvemap.model.lookup_table import lookup_table
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.residual_spread import TWO_SIDED_95, ResidualSpread
from valvemap.model.samples import Floats, Samples
from valvemap.model.support import Support
from valvemap.model.survey import survey as survey_of
from valvemap.vocabulary.statuses import DELIVERS, InverseStatus

U_LABEL, DP_LABEL = "control voltage U, %", "pressure drop Δp, bar"
Q_LABEL = "flow Q, l/min"


def learnt(estimator: Estimator[Any], samples: Samples) -> tuple[Any, Support]:
    """Return an estimator's state after the samples, and their region."""
    state, trace = estimator.update(estimator.initial_state(), samples)
    return state, Support.none().add(samples, trace)


def extrapolation() -> Figure:
    """Draw the width of the interval, and where a map is extrapolated, for two valves."""
    figure, axes = panels()
    U, dp = np.meshgrid(np.linspace(0.0, 100.0, 101), np.linspace(2.0, 200.0, 100))
    points = U.ravel(), dp.ravel(), valves.warm(U.ravel())
    cases = ("Eq. (7) fits, RLS", valves.even), ("S-shape, RLS (/// extrapolated)", valves.s_shape)
    for panel, (title, flow) in zip(axes, cases, strict=True):
        samples = valves.scattered(5_000, flow, (10.0, 70.0), (20.0, 140.0))
        rls = RecursiveLeastSquares()
        state, support = learnt(rls, samples)
        std, guessed = trusted(rls, state, support, points, *rls.predict(state, *points))
        half = np.clip(TWO_SIDED_95 * std, 0.01, 100.0)
        levels = np.array([0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0])
        drawn = panel.contourf(
            U, dp, np.log10(half).reshape(U.shape), np.log10(levels), cmap="YlGnBu", extend="both"
        )
        hatched = np.where(guessed, 1.0, 0.0).reshape(U.shape)
        panel.contourf(U, dp, hatched, [0.5, 1.5], colors="none", hatches=["///"])
        panel.plot([10, 70, 70, 10, 10], [20, 20, 140, 140, 20], color=SECOND)
        panel.text(12.0, 24.0, "samples", color=SECOND)
        label(panel, title, U_LABEL, DP_LABEL)
    bar = figure.colorbar(drawn, ax=list(axes))
    bar.set_ticks(np.log10(levels), labels=[f"{x:g}" for x in levels])
    bar.set_label("half 95 % interval, l/min")
    return figure


def inverse_map() -> Figure:
    """Draw U over the flow at four pressure drops, its interval and the reach."""
    auto = FlowMap()
    state, support = learnt(auto, valves.scattered(6_000, valves.dead_band))
    figure, (left, right) = panels()
    for color, dp in zip(CURVES, (10.0, 40.0, 100.0, 180.0), strict=True):
        highest = float(valves.dead_band(np.array([100.0]), np.array([dp]))[0])
        Q = np.linspace(0.0, 1.15 * highest, 301)
        found = invert(auto, state, Q, np.full_like(Q, dp), valves.warm(Q), support=support)
        given = np.isin(found.status, DELIVERS)
        left.plot(Q[given], found.U[given], color=color, label=f"Δp = {dp:.0f} bar")
        beyond = found.status == InverseStatus.ABOVE_REACH
        left.plot(Q[beyond], found.U[beyond], ":", color=color)
        true = 8.0 + 82.0 * Q / highest
        share = 100.0 * Q / highest
        inner = given & (share > 2.0) & (share < 97.0)
        share = share[inner]
        right.plot(share, (found.U - true)[inner], color=color)
        bounds = (found.lower - found.U)[inner], (found.upper - found.U)[inner]
        right.fill_between(share, *bounds, color=color, alpha=0.15, linewidth=0)
    label(left, "U = f(Q, Δp); dotted: ABOVE_REACH", Q_LABEL, U_LABEL)
    label(
        right,
        "Error of U; shaded: 95 % interval",
        "share of the largest flow at Δp, %",
        "error of U, %",
    )
    legend(left, "lower right")
    return figure


def models() -> Figure:
    """Draw the points of an exported table, and the error of interpolation between them."""
    auto = FlowMap()
    state, _ = learnt(auto, valves.scattered(4_000, valves.dead_band))
    table = lookup_table(auto, state)
    figure, (left, right) = panels()
    for k in range(0, len(table.r), 2):
        flow = table.lowest + table.r[k] * (table.highest - table.lowest)
        left.plot(table.dp, flow, color=SAMPLES, linewidth=0.7)
        left.scatter(table.dp, flow, c=table.U[k], s=7, vmin=0.0, vmax=100.0, cmap="viridis")
    points = left.collections[0]
    figure.colorbar(points, ax=left, label="U of the table, %")
    left.plot(table.dp, table.highest, color=TRUTH)
    rng = np.random.default_rng(3)
    dp, share = rng.uniform(5.0, 200.0, 2_000), rng.uniform(0.0, 1.0, 2_000)
    low, high = (np.interp(dp, table.dp, x) for x in (table.lowest, table.highest))
    Q = low + share * (high - low)
    U, _ = table.interpolate(Q, dp)
    passed, _ = auto.predict(state, U, dp, valves.warm(U))
    right.semilogy(100.0 * share, np.abs(passed - Q) + 1e-6, ".", color=FIRST, markersize=2)
    right.axhline(table.error_Q, color=SECOND, label="stated error")
    right.set_ylim(1e-4, 3.0 * table.error_Q)
    label(left, "Points of the table (every second r)", DP_LABEL, Q_LABEL)
    label(
        right,
        "Error of the flow at 2,000 points",
        "share r of the range, %",
        "|error of the flow|, l/min",
    )
    legend(right, "lower right")
    return figure


def intervals() -> Figure:
    """Draw the intervals of the map and of a measurement, and the coverage under forgetting."""
    figure, (left, right) = panels()
    rls = RecursiveLeastSquares()
    samples = valves.scattered(40, valves.even, dp=(99.0, 101.0))
    samples = valves.at(valves.even, samples.U, samples.dp + 40.0 * np.sin(samples.U), 5, 6.0)
    state, trace = rls.update(rls.initial_state(), samples)
    spread = ResidualSpread.none().add(samples, trace)
    U = np.linspace(0.0, 100.0, 101)
    dp = np.full_like(U, 100.0)
    Q, std = rls.predict(state, U, dp, valves.warm(U))
    half = spread.half_width(U, dp, std)
    left.fill_between(U, Q - half, Q + half, color=FIRST, alpha=0.15, label="next measurement")
    band = TWO_SIDED_95 * std
    left.fill_between(U, Q - band, Q + band, color=FIRST, alpha=0.45, label="map")
    left.plot(U, valves.even(U, dp), "--", color=TRUTH, label="valve")
    near = samples.Q * np.sqrt(100.0 / samples.dp)
    left.plot(samples.U, near, ".", color=SECOND, label="samples, as at 100 bar")
    label(left, "95 % intervals after 40 samples, Δp = 100 bar", U_LABEL, Q_LABEL)
    legend(left, "upper left")
    memories = np.array([25, 50, 100, 200, 400])
    shares = np.array([coverage(memory) for memory in memories.tolist()])
    right.semilogx(memories, 100.0 * shares[:, 0], "o-", color=SECOND, label="σ²·P")
    right.semilogx(memories, 100.0 * shares[:, 1], "o-", color=FIRST, label="σ²·P·S·P (published)")
    right.axhline(95.0, color=TRUTH, linestyle="--")
    right.set_xticks(memories, [str(m) for m in memories])
    right.minorticks_off()
    right.set_ylim(90.0, 100.5)
    label(
        right,
        "Coverage under forgetting",
        "memory 1/(1 − λ), samples",
        "intervals with the true value, %",
    )
    legend(right, "lower right")
    return figure


def coverage(memory: int, runs: int = 1_500) -> Floats:
    """Return the shares of intervals by σ²·P and by σ²·P·S·P that hold the true parameter (2,)."""
    rng, lam, N = np.random.default_rng(8), 1.0 - 1.0 / memory, 8 * memory
    held = np.zeros((runs, 2))
    weights = lam ** np.arange(N - 1, -1, -1.0)
    for run in range(runs):
        X = np.column_stack([np.ones(N), rng.uniform(-1.0, 1.0, N)])
        found = rls_of_rows(X, X @ [1.0, 2.0] + rng.normal(0.0, 1.0, N), lam)
        P = np.linalg.inv((X * weights[:, None]).T @ X)
        off = abs(found.theta[1] - 2.0)
        held[run] = off <= TWO_SIDED_95 * np.sqrt([P[1, 1], found.covariance[1, 1]])
    return np.asarray(held.mean(axis=0))


def survey() -> Figure:
    """Draw the map's standard deviation, and the next points before and after five of them."""
    rls, spread = RecursiveLeastSquares(), ResidualSpread.none()
    samples = valves.scattered(60, valves.even, (5.0, 40.0), (10.0, 80.0))
    state, trace = rls.update(rls.initial_state(), samples)
    spread = spread.add(samples, trace)
    U, dp = np.meshgrid(np.linspace(0.0, 100.0, 81), np.linspace(2.0, 200.0, 80))
    points = U.ravel(), dp.ravel(), valves.warm(U.ravel())
    figure, axes = panels()
    levels = np.array([0.03, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2])
    asked: list[tuple[float, float]] = []
    for panel, title in zip(
        axes, ("60 samples of one corner", "after 5 suggested samples"), strict=True
    ):
        _, std = rls.predict(state, *points)
        drawn = panel.contourf(
            U, dp, np.log10(std).reshape(U.shape), np.log10(levels), cmap="YlGnBu", extend="both"
        )
        panel.plot(samples.U, samples.dp, ".", color=SAMPLES, markersize=3)
        label(panel, title, U_LABEL, DP_LABEL)
        for n in range(5) if not asked else ():
            found = survey_of(rls, state, spread, n)
            asked.append((found.suggested_U, found.suggested_dp))
            x, y = (np.array([place]) for place in asked[-1])
            one = valves.at(valves.even, x, y, seed=10 + n)
            state, trace = rls.update(state, one)
            spread = spread.add(one, trace)
    for point in dict.fromkeys(asked):
        turns = ", ".join(str(n + 1) for n, other in enumerate(asked) if other == point)
        for panel in axes:
            panel.plot(*point, "o", color=SECOND, markersize=5)
            side = "right" if point[0] > 50.0 else "left"
            panel.annotate(f"  {turns}  ", point, color=SECOND, ha=side, va="center", weight="bold")
            panel.set(xlim=(-5.0, 105.0), ylim=(-8.0, 212.0))
    bar = figure.colorbar(drawn, ax=list(axes))
    bar.set_ticks(np.log10(levels), labels=[f"{x:g}" for x in levels])
    bar.set_label("standard deviation of Q̂, l/min")
    return figure
