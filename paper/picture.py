"""A picture with its plotted numbers, and the common style."""

import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from valvemap.model.samples import Floats
from valvemap.report.plots import COLOURS, GREY

BLUE, VERMILION, GREEN, PINK, ORANGE, SKY, BLACK = COLOURS
PALE: Final = "#dddddd"
MOST: Final = 250

Series = Mapping[str, Mapping[str, list[float | None]]]


@dataclass(frozen=True)
class Picture:
    """A picture of the report.

    Attributes
    ----------
    key : str
        File name without extension.
    title, caption : str
        Title, and an explanation of the picture.
    png : bytes
    numbers : {series: {column: values}}
        Plotted values; long series are thinned to MOST values.
    """

    key: str
    title: str
    caption: str
    png: bytes = field(repr=False)
    numbers: Series = field(repr=False)


def canvas(width: float, height: float) -> Figure:
    """Return an empty figure; size in inches."""
    return Figure(figsize=(width, height), layout="constrained")


def quiet(axes: Axes) -> Axes:
    """Apply the style: grid in the background, no frame at top and right, small tick labels."""
    axes.grid(visible=True, color=PALE, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    axes.xaxis.label.set_fontsize(9)
    axes.yaxis.label.set_fontsize(9)
    return axes


def label(axes: Axes, text: str, x: float = 0.03, y: float = 0.97) -> None:
    """Add a text in a corner of the panel."""
    axes.text(x, y, text, transform=axes.transAxes, verticalalignment="top", fontsize=8, color=GREY)


Place = Literal["best", "upper left", "lower left", "lower right"]


def legend(axes: Axes, place: Place = "best", columns: int = 1) -> None:
    """Add a legend without a frame."""
    axes.legend(fontsize=8, frameon=False, loc=place, ncols=columns, markerscale=1.5)


def png_of(figure: Figure) -> bytes:
    """Return the bytes of the PNG file."""
    buffer, layout = io.BytesIO(), figure.get_layout_engine()
    if layout is not None:
        layout.execute(figure)
        figure.set_layout_engine(None)  # with one, a figure is drawn twice
    figure.savefig(buffer, dpi=110, format="png", metadata={"Software": None})
    return buffer.getvalue()


def numbers(**columns: ArrayLike) -> Mapping[str, list[float | None]]:
    """Return columns of equal length as lists, thinned evenly; non-finite values are None.

    >>> numbers(x=np.arange(3), y=[1.0, np.nan, 2.5])
    {'x': [0.0, 1.0, 2.0], 'y': [1.0, None, 2.5]}
    """
    return {name: _listed(np.asarray(column, np.float64)) for name, column in columns.items()}


def _listed(column: Floats) -> list[float | None]:
    every = -(-len(column) // MOST) or 1
    kept = column[::every]
    return [float(f"{x:.6g}") if np.isfinite(x) else None for x in kept.tolist()]
