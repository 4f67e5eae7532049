"""Axes of one size and style, and the file that they are written to."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

PAGES: Final = Path(__file__).parents[2] / "docs" / "methods"
WIDTH, HEIGHT, DOTS = 9.0, 3.6, 100  # inches, inches, dots per inch: 900 dots wide
TRUTH, FIRST, SECOND, THIRD, SAMPLES = "#222222", "#0072b2", "#d55e00", "#009e73", "#9a9a9a"
CURVES: Final = FIRST, SECOND, THIRD, "#cc79a7"
STYLE: Final[dict[Any, Any]] = {
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.4,
    "axes.titlesize": 10,
}


def panels(columns: int = 2, rows: int = 1, **keywords: Any) -> tuple[Figure, Sequence[Axes]]:  # noqa: ANN401 - matplotlib's own
    """Return a figure and its axes, row by row."""
    with mpl.rc_context(STYLE):
        figure = Figure((WIDTH, HEIGHT), dpi=DOTS, layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False, **keywords)
    return figure, list(axes.ravel())


def label(axes: Axes, title: str, x: str, y: str) -> None:
    """Give axes a title, and names with units."""
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)


def legend(axes: Axes, where: Any = "best", columns: int = 1) -> None:  # noqa: ANN401 - one of matplotlib's names
    """Name the curves, without a frame."""
    axes.legend(loc=where, ncols=columns, frameon=False, fontsize=8)


def write(figure: Figure, page: str, folder: Path = PAGES) -> Path:
    """Write the figure of a page as a small PNG, of at most 128 colours."""
    path, drawn = folder / f"{page}.png", BytesIO()
    figure.savefig(drawn, format="png")
    with Image.open(drawn) as picture:
        picture.convert("RGB").quantize(128, dither=Image.Dither.NONE).save(path, optimize=True)
    return path
