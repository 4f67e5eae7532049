"""Figures of the estimators: how they learn a map, and from which samples."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from documentation.figures import valves
from documentation.figures.canvas import (
    CURVES,
    FIRST,
    SAMPLES,
    SECOND,
    THIRD,
    TRUTH,
    label,
    legend,
    panels,
)
from valvemap.model.armax import recursive_maximum_likelihood as rml_of_rows
from valvemap.model.estimator import Estimator
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import Adaptive, Exponential, Forgetting
from valvemap.model.least_squares_of_arrays import recursive_least_squares as rls_of_rows
from valvemap.model.model_structures import FiveTerms, Polynomial, Structure
from valvemap.model.radial_basis import RadialBasis
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.model.tensor_spline import TensorSpline

U = np.linspace(0.0, 100.0, 401)
U_LABEL, Q_LABEL = "control voltage U, %", "flow Q, l/min"
ERROR_LABEL = "error of the flow, l/min"


def recursive_least_squares() -> Figure:
    """Draw a parameter that jumps, followed with three rules of forgetting."""
    samples = valves.scattered(5_000, valves.even)
    n = np.arange(len(samples))
    gain = np.where(n < 3_000, 1.0, 0.9)
    X = FiveTerms().regressors(samples.U, samples.dp, samples.T)
    grid_U, grid_dp = (x.ravel() for x in np.meshgrid(U[::40], np.linspace(2.0, 200.0, 11)))
    grid_X = FiveTerms().regressors(grid_U, grid_dp, valves.warm(grid_U))
    truth = gain[:, None] * [0.0, 0.0, 0.0, valves.FULL / 100.0, 0.0]
    rules: dict[str, Forgetting] = {
        "Exponential(1)": Exponential(1.0),
        "Exponential(0.99)": Exponential(0.99),
        "Adaptive()": Adaptive(),
    }
    figure, (left, right) = panels()
    for color, (name, rule) in zip((FIRST, SECOND, THIRD), rules.items(), strict=True):
        noise = samples.Q - valves.even(samples.U, samples.dp)
        found = rls_of_rows(X, X @ truth[0] * gain + noise, rule)
        left.plot(n, found.theta_history[:, 3], color=color, label=name)
        errors = (found.theta_history - truth)[::20] @ grid_X.T
        right.semilogy(n[::20], np.sqrt((errors**2).mean(axis=1)), color=color)
    left.plot(n, truth[:, 3], "--", color=TRUTH, label="true value", zorder=0)
    left.set_ylim(0.115, 0.15)
    right.set_ylim(0.005, 20.0)
    label(left, "Parameter a₄: the gain falls by 10 %", "samples", "a₄, l/min per (% · √bar)")
    label(right, "Error of the whole map", "samples", "RMSE of the map, l/min")
    legend(left, "lower left")
    return figure


def recursive_maximum_likelihood() -> Figure:
    """Draw the estimates of a model with coloured noise by RML and by RLS."""
    rng = np.random.default_rng(4)
    N = 4_000
    u, v = rng.choice([-1.0, 1.0], N), rng.normal(0.0, 1.0, N)
    y = np.zeros(N)
    for t in range(2, N):
        y[t] = 1.5 * y[t - 1] - 0.7 * y[t - 2] + u[t - 1] + 0.5 * u[t - 2]
        y[t] += v[t] - v[t - 1] + 0.2 * v[t - 2]
    rml = rml_of_rows(y, u, na=2, nb=2, nd=2).theta_history
    rows = np.column_stack([-y[1:-1], -y[:-2], u[1:-1], u[:-2]])
    rls = rls_of_rows(rows, y[2:]).theta_history
    figure, axes = panels()
    chosen = ((0, "a₁", -1.5), (1, "a₂", 0.7), (2, "b₁", 1.0), (3, "b₂", 0.5))
    for color, (k, name, true) in zip(CURVES, chosen, strict=True):
        for panel, found in zip(axes, (rls, rml), strict=True):
            panel.semilogx(np.arange(1, len(found) + 1), found[:, k], color=color, label=name)
            panel.axhline(true, color=color, linestyle="--", linewidth=0.9)
    for panel, title in zip(axes, ("RLS: biased", "RML: unbiased"), strict=True):
        label(panel, title, "samples", "parameter (dashed: true value)")
        panel.set_ylim(-2.0, 1.6)
        panel.set_xlim(10, N)
    legend(axes[1], "lower right", 4)
    return figure


def rbf_network() -> Figure:
    """Draw what a network and fixed centres keep of sorted samples."""
    sorted_, mixed = valves.sorted_levels(valves.s_shape), valves.scattered(5_500, valves.s_shape)
    cases: tuple[tuple[str, Estimator[Any], Samples], ...] = (
        ("network, sorted", RbfNetwork(), sorted_),
        ("network, scattered", RbfNetwork(), mixed),
        ("RadialBasis with RLS, sorted", RecursiveLeastSquares(RadialBasis.uniform()), sorted_),
    )
    figure, (left, right) = panels()
    dp = np.full_like(U, 100.0)
    true = valves.s_shape(U, dp)
    left.plot(U, true, "--", color=TRUTH, label="valve")
    for color, (name, estimator, samples) in zip((SECOND, FIRST, THIRD), cases, strict=True):
        state, _ = estimator.update(estimator.initial_state(), samples)
        Q, _ = estimator.predict(state, U, dp, valves.warm(U))
        left.plot(U, Q, color=color, label=name)
        right.semilogy(U, np.abs(Q - true) + 1e-3, color=color)
    label(left, "Map at Δp = 100 bar after 5,500 samples", U_LABEL, Q_LABEL)
    label(right, "Its error", U_LABEL, "|error of the flow|, l/min")
    right.set_ylim(0.01, 300.0)
    legend(left, "lower right")
    return figure


def model_structures() -> Figure:
    """Draw maps of four structures of a valve with a dead band and a saturation."""
    samples = valves.scattered(6_000, valves.dead_band)
    spline = TensorSpline.uniform()
    kinks = TensorSpline(spline.U, spline.s, dead_band=8.0, saturation=90.0)
    structures: dict[str, Structure] = {
        "eq. (7)": FiveTerms(),
        "polynomial, order 4": Polynomial.of_order(4),
        "spline": spline,
        "spline with dead band and saturation": kinks,
    }
    figure, (left, right) = panels()
    dp = np.full_like(U, 100.0)
    true = valves.dead_band(U, dp)
    left.plot(U, true, "--", color=TRUTH, label="valve")
    for color, (name, structure) in zip(
        (SECOND, CURVES[3], FIRST, THIRD), structures.items(), strict=True
    ):
        rls = RecursiveLeastSquares(structure)
        state, _ = rls.update(rls.initial_state(), samples)
        Q, _ = rls.predict(state, U, dp, valves.warm(U))
        left.plot(U, Q, color=color, label=name)
        right.plot(U, Q - true, color=color)
    label(left, "Map at Δp = 100 bar", U_LABEL, Q_LABEL)
    label(right, "Its error (noise of a sample: 0.4 l/min)", U_LABEL, ERROR_LABEL)
    legend(left, "upper left")
    return figure


def auto() -> Figure:
    """Draw the map that Auto chooses, and how its error falls and recovers after damage."""
    whole = valves.sweeps(18_000, valves.dead_band)
    damaged = valves.sweeps(18_000, lambda U, dp: 0.8 * valves.dead_band(U, dp))
    Q = np.where(np.arange(len(whole)) < 6_000, whole.Q, damaged.Q)
    samples = Samples.of(whole.t, whole.U, whole.p1, whole.p2, Q, whole.T)
    grid_U, grid_dp = (x.ravel() for x in np.meshgrid(U[::16], np.linspace(10.0, 190.0, 10)))
    true = valves.dead_band(grid_U, grid_dp)
    figure, (left, right) = panels()
    names: dict[str, Estimator[Any]] = {
        "eq. (7), RLS": RecursiveLeastSquares(forgetting=Adaptive()),
        "Auto": FlowMap(),
    }
    for color, (name, estimator) in zip((SECOND, FIRST), names.items(), strict=True):
        state, errors, n = estimator.initial_state(), [], np.arange(200, len(samples) + 1, 200)
        for stop in n:
            state, _ = estimator.update(state, samples[stop - 200 : stop])
            found, _ = estimator.predict(state, grid_U, grid_dp, valves.warm(grid_U))
            valve = true if stop <= 6_000 else 0.8 * true
            errors.append(float(np.sqrt(np.mean((found - valve) ** 2))))
            if stop == 6_000:
                for dp in (20.0, 80.0, 180.0):
                    curve, _ = estimator.predict(state, U, np.full_like(U, dp), valves.warm(U))
                    left.plot(U, curve, color=color, label=name if dp == 20.0 else None)
        right.semilogy(n / 100.0, errors, color=color, label=name)
    for dp in (20.0, 80.0, 180.0):
        flow = valves.dead_band(U, np.full_like(U, dp))
        left.plot(U, flow, "--", color=TRUTH, label="valve" if dp == 20.0 else None)
        left.annotate(f"{dp:.0f} bar", (100.0, flow[-1]), ha="right", va="bottom", fontsize=8)
    right.axvline(60.0, color=SAMPLES, linestyle=":")
    right.annotate(" −20 % flow", (60.0, right.get_ylim()[1]), va="top")
    label(left, "Maps after 60 s of sweeps", U_LABEL, Q_LABEL)
    label(right, "Error of the whole map", "time, s", "RMSE of the map, l/min")
    legend(left, "upper left")
    return figure
