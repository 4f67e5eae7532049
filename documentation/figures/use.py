"""Figures of maps in use: which estimator's map, and the feed-forward that follows it."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from documentation.figures import valves
from documentation.figures.canvas import (
    FIRST,
    SAMPLES,
    SECOND,
    THIRD,
    TRUTH,
    label,
    legend,
    panels,
)
from valvemap.model.estimator import Estimator
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import Exponential
from valvemap.model.inverse_map import invert
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.places import Places

U_LABEL, Q_LABEL = "control voltage U, %", "flow Q, l/min"


def recommendation() -> Figure:
    """Draw one-step errors, errors of the map and the score of three estimators."""
    names: dict[str, Estimator[Any]] = {
        "RLS, λ = 0.95": RecursiveLeastSquares(forgetting=Exponential(0.95)),
        "RLS, λ = 1": RecursiveLeastSquares(),
        "Auto": FlowMap(),
    }
    samples = valves.sweeps(12_000, valves.s_shape)
    states = [estimator.initial_state() for estimator in names.values()]
    places, begun, steps = Places(len(names), 1), 0, []
    while begun < len(samples):
        stop = min(begun + int(places.due(np.zeros(1, np.int64))[0]), len(samples))
        batch, begun = samples[begun:stop], stop
        found = [e.update(s, batch) for e, s in zip(names.values(), states, strict=True)]
        states = [state for state, _ in found]
        residual, early = (
            np.array([getattr(t, k) for _, t in found]) for k in ("residual", "early")
        )
        steps.append(residual)
        status = np.array([trace.status for _, trace in found])
        places.learn(batch, residual, early, status, Segments.one(len(batch)))
        at = places.points(0)
        places.look_back(
            0, [e.predict(s, *at) for e, s in zip(names.values(), states, strict=True)]
        )
    score = places.ranking(0).errors
    one_step = np.sqrt(np.nanmean(np.hstack(steps)[:, 6_000:] ** 2, axis=1))
    U, dp = (x.ravel() for x in np.meshgrid(np.linspace(2, 98, 40), np.linspace(12, 188, 40)))
    true = valves.s_shape(U, dp)
    maps = [
        e.predict(s, U, dp, valves.warm(U))[0] for e, s in zip(names.values(), states, strict=True)
    ]
    whole = [float(np.sqrt(np.mean((Q - true) ** 2))) for Q in maps]
    figure, (left, right) = panels()
    for color, values, name, shift in (
        (SAMPLES, one_step, "one-step error", -0.27),
        (FIRST, score, "score", 0.0),
        (TRUTH, whole, "true error of the whole map", 0.27),
    ):
        bars = left.bar(np.arange(3) + shift, values, 0.25, color=color, label=name)
        left.bar_label(bars, fmt="%.2g", fontsize=8)
    left.set_yscale("log")
    left.set_ylim(0.01, 1_000.0)
    left.set_xticks(range(3), list(names))
    x = np.linspace(0.0, 100.0, 201)
    drop = np.full_like(x, 100.0)
    right.plot(x, valves.s_shape(x, drop), "--", color=TRUTH, label="valve")
    for color, (name, e), state in zip((SECOND, THIRD, FIRST), names.items(), states, strict=True):
        right.plot(x, e.predict(state, x, drop, valves.warm(x))[0], color=color, label=name)
    label(left, "Errors after 120 s of slow sweeps", "estimator", "RMS, l/min")
    label(right, "Maps at Δp = 100 bar", U_LABEL, Q_LABEL)
    legend(left, "upper right")
    legend(right, "upper left")
    return figure


def feedforward() -> Figure:
    """Draw the flow and its error where U comes from a map that learns, and from a fixed one."""
    step, damage, N = 0.02, 20.0, 3_000
    t = np.arange(N) * step
    demand = 40.0 + 25.0 * np.sin(0.9 * t) + 6.0 * np.sin(2.3 * t)
    dp = 80.0 + 45.0 * np.sin(0.37 * t) + 12.0 * np.sin(1.7 * t)
    gain = np.where(t < damage, 1.0, 0.7)
    commissioning = valves.scattered(4_000, valves.dead_band, dp=(5.0, 200.0))
    figure, (left, right) = panels()
    left.plot(t, demand, "--", color=TRUTH, label="demand")
    rng = np.random.default_rng(6)
    for color, name, learns in ((SECOND, "fixed map", False), (FIRST, "Auto, learning", True)):
        auto = FlowMap()
        state, _ = auto.update(auto.initial_state(), commissioning)
        flow = np.empty(N)
        for begun in range(0, N, 10):
            now = slice(begun, begun + 10)
            found = invert(auto, state, demand[now], dp[now], valves.warm(dp[now]))
            U = np.clip(np.nan_to_num(found.U), 0.0, 100.0)
            flow[now] = gain[now] * valves.dead_band(U, dp[now])
            if learns:
                Q = flow[now] + rng.normal(0.0, valves.SIGMA, 10)
                ns = commissioning.t[-1] + ((t[now] + step) * 1e9).astype(np.int64)
                rows = Samples.of(ns, U, dp[now], 0.0 * U, Q, valves.warm(U))
                state, _ = auto.update(state, rows)
        left.plot(t, flow, color=color, label=name)
        right.plot(t, flow - demand, color=color, label=name)
    for panel in (left, right):
        panel.axvline(damage, color=SAMPLES, linestyle=":")
    left.annotate(" −30 % flow", (damage, left.get_ylim()[1]), va="top")
    label(left, "Demand and flow", "time, s", Q_LABEL)
    label(right, "Error of the flow", "time, s", "flow − demand, l/min")
    left.set_ylim(-8.0, 80.0)
    legend(left, "lower center", 3)
    return figure
