"""What `benchmarks.honest_maps` measures: cells of a table, each seed by seed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

Figures = dict[str, Any]  # of one seed, as JSON holds them


@dataclass(frozen=True)
class Judged:
    """A cell for the seeds done: figure, bar, and whether it is met."""

    figure: str
    bar: str
    met: bool


@dataclass(frozen=True)
class Cell:
    """Seeds that the bar asks for; the figures of one; their summary.

    Cells with the same ``shared`` judge the same figures.
    """

    seeds: int
    one: Callable[[int], Figures]
    judge: Callable[[Sequence[Figures]], Judged]
    shared: str = ""
