"""The figures of docs/methods, one per page, drawn by the project's own code."""

from collections.abc import Callable
from typing import Final

from matplotlib.figure import Figure

from documentation.figures import answers, estimators, use

FIGURES: Final[dict[str, Callable[[], Figure]]] = {
    "auto": estimators.auto,
    "extrapolation": answers.extrapolation,
    "feedforward": use.feedforward,
    "intervals": answers.intervals,
    "inverse_map": answers.inverse_map,
    "model_structures": estimators.model_structures,
    "models": answers.models,
    "rbf_network": estimators.rbf_network,
    "recommendation": use.recommendation,
    "recursive_least_squares": estimators.recursive_least_squares,
    "recursive_maximum_likelihood": estimators.recursive_maximum_likelihood,
    "survey": answers.survey,
}
