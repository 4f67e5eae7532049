"""The table of flow maps' errors."""

import math
from collections.abc import Mapping
from typing import Protocol

from rich.table import Table


class Figures(Protocol):
    """Errors over n samples, as :class:`valvemap.pipeline.score.Score` has them; NaN if unknown."""

    @property
    def rmse(self) -> float:
        """Root of the mean squared error, l/min."""

    @property
    def nrmse(self) -> float:
        """``rmse`` over the range of Q."""

    @property
    def max_abs(self) -> float:
        """Largest absolute error, l/min."""

    @property
    def r2(self) -> float:
        """Coefficient of determination."""

    @property
    def n(self) -> int:
        """Samples that count."""


def verification_table(
    title: str,
    scores: Mapping[str, Mapping[str, Figures]],
    again: Mapping[str, Mapping[str, float]] | None = None,
) -> Table:
    """Table of valves and their estimators × figures, for a terminal.

    Parameters
    ----------
    title
        The compared quantities.
    scores
        Valve → estimator → its figures, shown in this order.
    again
        Valve → estimator → its error at places visited again, l/min; None: no such column.

    Examples
    --------
    >>> from rich.console import Console
    >>> from valvemap.pipeline.score import Score
    >>> Console(width=80).print(verification_table("Nothing yet", {"V1": {"RLS": Score.none()}}))
    Nothing yet...
    │ V1    │ RLS       │     - │          - │       - │  - │       0 │
    ...
    """
    table = Table(title=title, title_justify="left")
    for heading in ("Valve", "Estimator"):
        table.add_column(heading)
    if again is not None:
        table.add_column("again\nl/min", justify="right")
    for heading in ("RMSE\nl/min", "NRMSE\n% of range", "max |e|\nl/min", "R²", "samples"):
        table.add_column(heading, justify="right")
    for valve, estimators in scores.items():
        for i, (estimator, figures) in enumerate(estimators.items()):
            table.add_row(
                valve if i == 0 else "",
                estimator,
                *([] if again is None else [_figure(again[valve][estimator])]),
                _figure(figures.rmse),
                _figure(100 * figures.nrmse),
                _figure(figures.max_abs),
                _figure(figures.r2, ".5f"),
                f"{figures.n:,}",
            )
        table.add_section()
    return table


def _figure(value: float, form: str = ".4g") -> str:
    return "-" if math.isnan(value) else format(value, form)
