"""Tables of the demo."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rich.table import Table

from valvemap.pipeline.identification import Identification


def waiting(seconds: float) -> str:
    """Say for what the first start of a demo waits.

    >>> waiting(41.3)
    'first start: quick estimators run; Auto starts once compiled, a minute or two (41 s so far)'
    """
    return (
        "first start: quick estimators run; Auto starts once compiled, a minute or two "
        f"({seconds:.0f} s so far)"
    )


@dataclass(frozen=True)
class Verdict:
    """RMSE of each estimator's map of a valve against the rig's noise-free map, l/min.

    ``best_fit_rmse`` is the RMSE of eq. (7) fitted to the noise-free map (batch LSM): the lower
    bound for its five parameters on this valve.
    """

    valve: str
    samples: int
    rmse: Mapping[str, float]
    best_fit_rmse: float
    points: int

    def line(self) -> str:
        """One line for a log.

        >>> Verdict("Valvistor", 100, {"RLS": 2.0}, 1.9, 800).line()
        'Valvistor: 100 samples; RMSE against the truth, l/min: RLS 2.00; eq. (7) at best 1.90'
        """
        rmse = ", ".join(f"{name} {value:.2f}" for name, value in self.rmse.items())
        return (
            f"{self.valve}: {self.samples:,} samples; RMSE against the truth, l/min: {rmse}; "
            f"eq. (7) at best {self.best_fit_rmse:.2f}"
        )


def status_table(
    identification: Identification, verdicts: Sequence[Verdict], *, title: str = "live"
) -> Table:
    """Live table: one row for each estimator."""
    table = Table(title=title, title_justify="left")
    for heading in ("valve", "samples", "gaps", "estimator", "status"):
        table.add_column(heading)
    for heading in ("residual, l/min", "error of the map, l/min"):
        table.add_column(heading, justify="right")
    for number, verdict in enumerate(verdicts):
        result = identification.results.one(number)
        first = [verdict.valve, f"{verdict.samples:,}", str(result.counters["gaps"])]
        for name, estimator in result.estimators.items():
            table.add_row(
                *first,
                name,
                estimator.status.name.lower(),
                f"{estimator.residual_rmse:.3f}",
                f"{verdict.rmse.get(name, math.nan):.3f}",
            )
            first = ["", "", ""]
        table.add_row("", "", "", "eq. (7) at best", "", "", f"{verdict.best_fit_rmse:.3f}")
    return table


def verdict_table(verdicts: Sequence[Verdict]) -> Table:
    """Verification table at the end."""
    title = "Verification against the rig's noise-free truth: RMSE of the map, l/min"
    table = Table(title=title, title_justify="left")
    for heading in ("valve", "map"):
        table.add_column(heading)
    for heading in ("RMSE", "points"):
        table.add_column(heading, justify="right")
    for verdict in verdicts:
        rows = {**verdict.rmse, "eq. (7) fitted to the truth (batch LSM)": verdict.best_fit_rmse}
        for name, rmse in rows.items():
            table.add_row(verdict.valve, name, f"{rmse:.3f}", f"{verdict.points:,}")
    return table
