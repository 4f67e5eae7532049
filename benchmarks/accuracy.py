"""Accuracy of the estimators on data by others: ``python -m benchmarks.accuracy``.

Prints the figures of docs/accuracy.md and writes them to benchmarks/results/accuracy.json.
"""

import platform
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import measured_data, peers, results_file
from benchmarks.certified import digits_of_std, digits_of_theta, strucchange_errors
from benchmarks.recordings import (
    COOLING_CIRCUIT,
    ahead,
    air_valve_error,
    armax,
    arx,
    cooling_circuit_regressors,
    one_step_ahead,
    settled_r2,
)
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import (
    Adaptive,
    Directional,
    Exponential,
    SlidingWindow,
    Subspace,
    Variable,
)
from valvemap.model.least_squares_of_arrays import recursive_least_squares
from valvemap.model.model_structures import FiveTerms, Polynomial
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.tensor_spline import TensorSpline

Figures = dict[str, dict[str, float | None]]
RESULTS = Path(__file__).parent / "results" / "accuracy.json"
RULES = (
    Exponential(1.0),
    Exponential(0.999),
    Exponential(0.99),
    Variable(0.995),
    SlidingWindow(100),
    Directional(0.99),
    Subspace(0.99),
    Adaptive(),
    Adaptive(0.99),
)
HORIZONS = (1, 60, 600)  # s
PRIORS = (1.0, 10.0, 1e4)
ORDERS = ((2, 1, 1), (2, 2, 1), (2, 2, 2), (3, 2, 1))
BREAKS = tuple(np.linspace(0.0, 100.0, 9).tolist())
MAPS = {
    "eq. (7)": RecursiveLeastSquares(structure=FiveTerms()),
    "fifth order in U": RecursiveLeastSquares(
        structure=Polynomial(("1", "U", "U^2", "U^3", "U^4", "U^5"))
    ),
    "spline, 8 cells": RecursiveLeastSquares(structure=TensorSpline(U=BREAKS, s=(0.0, 1.0, 2.0))),
    "Auto": FlowMap(),
}


def main() -> int:
    """Measure, print, write."""
    if not measured_data.elsewhere_is_there():
        print(measured_data.ABSENT, file=sys.stderr)
        return 1
    there = peers.installed()
    absent = [name for name in peers.PEERS if name not in there]
    used = {name: version(name) for name in ("numpy", "scipy", "numba")} | there
    console = Console()
    console.print("versions:", ", ".join(f"{name} {number}" for name, number in used.items()))
    console.print("not installed, left out:", ", ".join(absent) or "none")
    figures = {}
    for name, title, form, measure in SECTIONS:
        figures[name] = measure(list(there))
        console.print(_table(title, form, figures[name]))
    record = {
        "python": platform.python_version(),
        "versions": used,
        "not_installed": absent,
        **figures,
    }
    results_file.keep(RESULTS, record)
    return 0


def nist(others: list[str]) -> Figures:
    """NIST StRD, linear regression."""
    figures = {}
    for problem in measured_data.nist_problems():
        figures[problem.name] = digits_of_theta(problem, others)
        if all(problem.std):
            figures[problem.name]["valvemap, std"] = digits_of_std(problem)
    return figures


def strucchange(_: list[str]) -> Figures:
    """R strucchange, beside rational arithmetic."""
    errors = strucchange_errors(measured_data.strucchange())
    return {name: {"largest": error} for name, error in errors.items()}


def one_step(others: list[str]) -> Figures:
    """Cooling circuit, one second ahead, while adapting."""
    circuit = measured_data.cooling_circuit()
    X, Q = cooling_circuit_regressors(circuit), circuit.Q
    found = {str(rule): one_step_ahead(circuit, rule) for rule in RULES}
    _, trace = FlowMap().update(FlowMap().initial_state(), circuit)
    found["Auto"] = settled_r2(Q, trace.residual)
    for name in (name for name in others if name in peers.FOLLOWERS):
        found[f"{name}, λ = 0.999"] = settled_r2(Q, peers.FOLLOWERS[name](X, Q, 0.999))
    found["persistence"] = settled_r2(Q, np.diff(Q, prepend=Q[0]))
    return {name: {"R²": value} for name, value in found.items()}


def frozen(_: list[str]) -> Figures:
    """Cooling circuit, further ahead, with the parameters frozen."""
    circuit = measured_data.cooling_circuit()
    X = cooling_circuit_regressors(circuit)
    figures: Figures = {}
    for rule in (Exponential(0.999), Variable(0.995)):
        history = recursive_least_squares(X, circuit.Q, rule).theta_history
        results = {h: ahead(circuit, history, h) for h in HORIZONS}
        figures[str(rule)] = {f"{h} s": figure.frozen for h, figure in results.items()}
    figures["persistence"] = {f"{h} s": figure.persistence for h, figure in results.items()}
    return figures


def actuator(_: list[str]) -> Figures:
    """Actuator, second half."""
    data = measured_data.actuator()
    models = {
        f"ARX({na},{nb})": arx(data, na, nb) for na, nb in sorted({orders[:2] for orders in ORDERS})
    }
    for orders in ORDERS:
        name = ",".join(map(str, orders))
        models |= {f"ARMAX({name}), p0 = {p0:g}": armax(data, *orders, p0) for p0 in PRIORS}
    return {
        name: {"one step": model.one_step, "simulated": model.simulated}
        for name, model in models.items()
    }


def air_valve(_: list[str]) -> Figures:
    """Air valve, between the points taught."""
    valve = measured_data.air_valve()
    errors = {name: air_valve_error(valve, estimator) for name, estimator in MAPS.items()}
    return {name: {"rmse": error.rmse, "largest": error.largest} for name, error in errors.items()}


SECTIONS = (
    ("nist", "NIST StRD: correct digits of theta", ".1f", nist),
    ("strucchange", "R strucchange: relative error", ".1e", strucchange),
    (
        "one_step",
        f"cooling circuit ({', '.join(COOLING_CIRCUIT.terms)}), one step ahead",
        ".6f",
        one_step,
    ),
    ("frozen", "cooling circuit: R² ahead with parameters frozen", ".6f", frozen),
    ("actuator", "actuator: RMSE on the second half", ".4f", actuator),
    ("air_valve", "air valve: error between the points taught, l/min", ".3f", air_valve),
)


def _table(title: str, form: str, figures: Figures) -> Table:
    table = Table(title=title, title_justify="left")
    columns = list(dict.fromkeys(name for row in figures.values() for name in row))
    table.add_column()
    for name in columns:
        table.add_column(name, justify="right")
    for name, row in figures.items():
        table.add_row(name, *(_cell(row[key], form) if key in row else "" for key in columns))
    return table


def _cell(value: float | None, form: str) -> str:
    return "not finite" if value is None else format(value, form)


if __name__ == "__main__":
    sys.exit(main())
