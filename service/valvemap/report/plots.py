"""Pictures of a verification, as PNG files; needs matplotlib."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from valvemap.errors import ConfigurationError
from valvemap.model.samples import Floats, Times
from valvemap.owned_files import naming, written_aside

try:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
except ImportError as _error:
    raise ConfigurationError("plots need matplotlib: pip install 'valvemap[plot]'") from _error

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
GREY: Final = "#555555"
_PICTURES: Final = ("png", "pdf", "svg")
_POINTS = 20_000
_PANELS = 12


def plot_agreement(path: Path, Q: Floats, predictions: Mapping[str, Floats]) -> None:
    """Predicted over measured flow, a panel per estimator: the fit is good along the 45° line.

    Parameters
    ----------
    path
        The PNG file.
    Q
        Measured or true flow, l/min, shape (N,).
    predictions
        Estimator → Q̂, l/min, shape (N,).

    Raises
    ------
    StorageError
        if the file cannot be written.
    """
    low, high = _span(Q)
    figure, panels = _panels(len(predictions), height=4.2, width=4.4)
    for axes, (name, Q_hat), colour in zip(panels, predictions.items(), _colours(), strict=False):
        rows = _thinned(len(Q))
        axes.plot([low, high], [low, high], color=GREY, linewidth=0.8, zorder=1)
        axes.scatter(Q[rows], Q_hat[rows], s=3, color=colour, alpha=0.25, linewidths=0, zorder=2)
        axes.set(xlim=(low, high), ylim=(low, high), aspect="equal")
        axes.set_xlabel("measured Q, l/min")
        axes.set_ylabel("predicted Q̂, l/min")
        axes.set_title(f"{name}: {_fit(Q, Q_hat)}", fontsize=10)
        _note_outside(axes, int(np.sum((Q_hat < low) | (Q_hat > high))))
    save_figure(figure, path)


def plot_residuals(path: Path, t: Times, residuals: Mapping[str, Floats]) -> None:
    """Residual Q - Q̂ over time, a panel per estimator, all to one scale.

    Parameters
    ----------
    path
        The PNG file.
    t
        Source time, UTC ns, shape (N,).
    residuals
        Estimator → residual before the update, l/min, shape (N,).

    Raises
    ------
    StorageError
        if the file cannot be written.
    """
    seconds = _seconds(t)
    late = [np.abs(e[len(e) // 4 :]) for e in residuals.values()]  # the start is still learning
    finite = np.concatenate([e[np.isfinite(e)] for e in late]) if late else np.empty(0)
    limit = 1.3 * float(np.percentile(finite, 99.8)) if len(finite) else 1.0
    limit = limit if limit > 0 else 1.0
    figure, panels = _panels(len(residuals), height=1.9, width=9.0, columns=1)
    for axes, (name, e), colour in zip(panels, residuals.items(), _colours(), strict=False):
        rows = _thinned(len(e))
        axes.plot(seconds[rows], e[rows], ".", color=colour, markersize=1.5, alpha=0.6)
        axes.axhline(0, color="black", linewidth=0.8)
        axes.tick_params(labelbottom=axes is panels[-1])
        axes.set(ylim=(-limit, limit), xlim=(0, max(seconds.max(initial=0), 1e-9)))
        axes.set_ylabel(f"{name}\nQ - Q̂, l/min")
        _note_outside(axes, int(np.sum(np.abs(e) > limit)))
    panels[-1].set_xlabel("time, s")
    save_figure(figure, path)


def plot_parameters(
    path: Path, t: Times, names: Sequence[str], theta: Floats, std: Floats | None = None
) -> None:
    """Parameters over time, a panel each (all in one if there are more than twelve).

    Parameters
    ----------
    path
        The PNG file.
    t
        Source time, UTC ns, shape (N,).
    names
        Names of the n parameters.
    theta
        Parameters, shape (N, n).
    std
        Standard deviations, shape (N, n); shown as a band of ±2.

    Raises
    ------
    StorageError
        if the file cannot be written.
    """
    seconds = _seconds(t)
    rows = _thinned(len(t))
    together = len(names) > _PANELS
    figure, panels = _panels(1 if together else len(names), height=2.4, width=4.2)
    for i, name in enumerate(names):
        axes = panels[0] if together else panels[i]
        colour = COLOURS[i % len(COLOURS)] if together else COLOURS[0]
        axes.plot(seconds[rows], theta[rows, i], color=colour, linewidth=1.0, label=name)
        if together:
            continue
        axes.set_title(f"{name} = {theta[-1, i]:.5g}" if len(t) else name, fontsize=10)
        band = 2 * std[:, i] if std is not None else np.zeros(len(t))
        lower, upper = theta[:, i] - band, theta[:, i] + band
        axes.fill_between(
            seconds[rows], lower[rows], upper[rows], color=colour, alpha=0.2, linewidth=0
        )
        axes.set_ylim(*_settled(np.stack([theta[:, i], lower, upper], axis=1)))
        axes.set_xlabel("time, s")
    if together:
        panels[0].set(xlabel="time, s", ylabel="parameters")
        panels[0].set_ylim(*_settled(theta))
    save_figure(figure, path)


def plot_map(
    path: Path,
    U: Floats,
    dp: Floats,
    Q: Floats,
    visited: tuple[Floats, Floats] | None = None,
) -> None:
    """The flow map Q(U, Δp) as contours, with the points that were visited, and as a surface.

    Parameters
    ----------
    path
        The PNG file.
    U, dp
        Grid, % of shape (m,) and bar of shape (k,).
    Q
        Flow, l/min, shape (m, k); NaN is left out.
    visited
        (U, Δp) of samples, each of shape (N,): outside them the map is a guess.

    Raises
    ------
    StorageError
        if the file cannot be written.
    """
    figure = Figure(figsize=(11.5, 5), layout="constrained")
    flat = figure.add_subplot(1, 2, 1)
    shown = np.ma.masked_invalid(Q)
    if visited is not None:
        rows = _thinned(len(visited[0]))
        flat.scatter(
            visited[0][rows], visited[1][rows], s=3, color="#c8c8c8", linewidths=0, zorder=0
        )
    lines = flat.contour(U, dp, shown.T, levels=12, cmap="viridis", linewidths=1.4)
    flat.clabel(lines, fmt="%g", fontsize=8)
    flat.set(xlabel="U, %", ylabel="Δp, bar", title="lines of equal flow, l/min")
    space = figure.add_subplot(1, 2, 2, projection="3d")
    grid_U, grid_dp = np.meshgrid(U, dp, indexing="ij")
    space.plot_surface(grid_U, grid_dp, shown, cmap="viridis", linewidth=0, antialiased=True)
    space.set(xlabel="U, %", ylabel="Δp, bar", zlabel="Q, l/min")
    space.view_init(elev=24, azim=-125)
    space.locator_params(nbins=5)
    save_figure(figure, path)


def _panels(
    count: int, *, height: float, width: float, columns: int = 3
) -> tuple[Figure, list[Axes]]:
    columns = max(1, min(columns, count if count != 4 else 2))
    rows = max(1, math.ceil(count / columns))
    figure = Figure(figsize=(width * columns, height * rows + 0.4), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    panels = list(grid.flat)
    for axes in panels[count:]:
        axes.remove()
    for axes in panels:
        axes.grid(visible=True, color="#dddddd", linewidth=0.6)
        axes.set_axisbelow(True)
    return figure, panels[: max(count, 1)]


def save_picture(figure: Figure, path: Path) -> None:
    """Write a PNG, PDF or SVG file, by its name.

    Raises
    ------
    ConfigurationError
        if the name ends in none of these.
    StorageError
        if it cannot be written.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in _PICTURES:
        raise ConfigurationError(f"{path}: the name of a picture ends in .png, .pdf or .svg")
    save_figure(figure, path, kind)


def save_figure(figure: Figure, path: Path, kind: str = "png") -> None:
    """Write a file of this kind.

    Raises
    ------
    StorageError
        if it cannot be written.
    """
    with naming(path, "cannot be written"):
        path.parent.mkdir(parents=True, exist_ok=True)
    with written_aside(path) as draft:
        figure.savefig(draft, dpi=140, format=kind)


def _colours() -> Sequence[str]:
    return COLOURS * 4


def _thinned(n: int) -> slice:
    return slice(None, None, max(1, n // _POINTS))


def _seconds(t: Times) -> Floats:
    return (t - t[0]) / 1e9 if len(t) else np.empty(0)


def _span(Q: Floats) -> tuple[float, float]:
    finite = Q[np.isfinite(Q)]
    if not len(finite):
        return -1.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin


def _settled(theta: Floats) -> tuple[float, float]:
    """Limits that show where parameters settle, not how far they swung at the start."""
    return _span(theta[len(theta) // 3 :])


def _fit(Q: Floats, Q_hat: Floats) -> str:
    known = np.isfinite(Q) & np.isfinite(Q_hat)
    if not known.any():
        return "nothing predicted"
    with np.errstate(all="ignore"):
        error = np.mean((Q[known] - Q_hat[known]) ** 2)
        r2 = 1 - error / np.var(Q[known])
    return f"RMSE {math.sqrt(error):.3g} l/min, R² {r2:.4f}"


def _note_outside(axes: Axes, count: int) -> None:
    if count:
        axes.text(
            0.01,
            0.97,
            f"{count:,} points outside",
            transform=axes.transAxes,
            verticalalignment="top",
            fontsize=8,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5},
        )
