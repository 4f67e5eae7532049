"""A valve's map for scripts and notebooks: predict, invert, compare, plot, save."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from valvemap.app.given import layout_of, recordings_in, shown
from valvemap.errors import ConfigurationError
from valvemap.model.extrapolation import U_range_of, trusted
from valvemap.model.inverse_map import invert
from valvemap.model.inversion import Inversion
from valvemap.model.residual_spread import TWO_SIDED_95
from valvemap.model.samples import Floats, Samples
from valvemap.storage.models import StoredModel, is_model, load_model, write_model
from valvemap.storage.tables import without_mask
from valvemap.vocabulary.statuses import Quality

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CURVES: Final = 5  # pressure drops in a picture
LEVELS_U, LEVELS_DP = 21, 11  # points of a table
Points = tuple[Floats, Floats, Floats]


@dataclass(frozen=True)
class Comparison:
    """Differences of flows from a model's, l/min: other minus model.

    Attributes
    ----------
    n : int
        Number of points.
    bias, rmse, max_abs : float
        Mean, root mean square and largest absolute difference.
    r2 : float
        Coefficient of determination; NaN if the other's flow is constant.
    covered : float
        Share of the points within the model's 95 % interval.
    """

    n: int
    bias: float
    rmse: float
    max_abs: float
    r2: float
    covered: float


class Model(StoredModel):
    """One valve's map, from :func:`valvemap.fit` or :func:`valvemap.open_model`.

    Everything is in %, bar, l/min and °C. Arguments are scalars or arrays that broadcast, and
    results have their shape, (1,) for scalars; ``T`` is the temperature measured last unless it is
    given. An argument that is no number is a `ConfigurationError`.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> U, dp = rng.uniform(0, 100, 2000), rng.uniform(5, 200, 2000)
    >>> import valvemap
    >>> rows = {"t": np.arange(2000), "U": U, "p1": dp, "p2": 0 * dp, "Q": 0.1 * U * np.sqrt(dp)}
    >>> model = valvemap.fit(rows)
    >>> model.predict(50.0, 100.0).round(1), model.invert(50.0, 100.0).U.round(1)
    (array([50.]), array([50.]))
    """

    def __repr__(self) -> str:
        return (
            f"<{self._title()}, noise {self.noise_std:.3g} l/min; "
            "predict, invert, interval, compare, plot, to_frame, save>"
        )

    def predict(self, U: ArrayLike, dp: ArrayLike, T: ArrayLike | None = None) -> Floats:
        """Flow at a control voltage and pressure drop, l/min; NaN where unknown."""
        given, shape = self._points(T, U=U, dp=dp)
        return self._predicted(given)[0].reshape(shape)

    def interval(
        self, U: ArrayLike, dp: ArrayLike, T: ArrayLike | None = None
    ) -> tuple[Floats, Floats]:
        """95 % interval of a new measurement of the flow: lower and upper bound, l/min.

        It contains the uncertainty of the map, which grows away from the samples, and the noise.
        """
        given, shape = self._points(T, U=U, dp=dp)
        Q, std, _ = self._predicted(given)
        half = TWO_SIDED_95 * np.hypot(std, self.noise_std)
        return (Q - half).reshape(shape), (Q + half).reshape(shape)

    def invert(self, Q: ArrayLike, dp: ArrayLike, T: ArrayLike | None = None) -> Inversion:
        """Control voltage that delivers a flow, with its 95 % interval and status."""
        given, shape = self._points(T, Q=Q, dp=dp)
        found = invert(self.estimator, self.state, *given, support=self.support)
        return Inversion(*(x.reshape(shape) for x in vars(found).values()))

    def compare(
        self,
        other: object,
        *,
        units: Mapping[str, str] | None = None,
        columns: Mapping[str, str] | None = None,
    ) -> Comparison:
        """Compare with the flows of a recording, or with another model where both have samples.

        Parameters
        ----------
        other
            A model, the path of a saved one, or recordings as in :func:`valvemap.fit`; rows of
            other valves and of bad quality are left out.
        units, columns
            As in :func:`valvemap.fit`.

        Raises
        ------
        ConfigurationError
            if there is nothing to compare.
        """
        if isinstance(other, str | os.PathLike) and is_model(Path(other)):
            other = load_model(Path(other))
        if isinstance(other, StoredModel):
            given, Q = self._shared_points(other)
        else:
            given, Q = self._measured(other, layout_of(units, columns))
        mine, std, _ = self._predicted(given)
        known = np.isfinite(mine) & np.isfinite(Q)
        if not known.any():
            raise ConfigurationError(f"nothing to compare with {self.valve}: no known flow")
        Q, off = Q[known], (Q - mine)[known]
        half = TWO_SIDED_95 * np.hypot(std, self.noise_std)[known]
        scatter = float(np.sum((Q - Q.mean()) ** 2))
        return Comparison(
            n=len(off),
            bias=float(off.mean()),
            rmse=float(np.sqrt(np.mean(off**2))),
            max_abs=float(np.abs(off).max()),
            r2=1.0 - float(np.sum(off**2)) / scatter if scatter > 0.0 else np.nan,
            covered=float(np.mean(np.abs(off) <= half)),
        )

    def plot(self, file: str | Path | None = None) -> "Figure":
        """Draw the flow over U at some pressure drops, with 95 % intervals; extrapolation dotted.

        Parameters
        ----------
        file
            A file to write, too: PNG, PDF or SVG by its name.

        Raises
        ------
        ConfigurationError
            if the name ends in none of these.
        """
        from valvemap.report.model_plot import Curve, draw_model  # noqa: PLC0415 - an extra
        from valvemap.report.plots import save_picture  # noqa: PLC0415

        U = np.linspace(*U_range_of(self.estimator), 101)
        curves = []
        least, largest = np.sqrt(self._drops())
        for dp in np.linspace(least, largest, CURVES + 1)[1:] ** 2:
            Q, std, guessed = self._predicted(self._points(None, U=U, dp=dp)[0])
            half = TWO_SIDED_95 * np.hypot(std, self.noise_std)
            curves.append(Curve(float(dp), U, Q, Q - half, Q + half, guessed))
        figure = draw_model(self._title(), curves)
        if file is not None:
            save_picture(figure, Path(file))
        return figure

    def to_frame(
        self,
        U: ArrayLike | None = None,
        dp: ArrayLike | None = None,
        backend: str = "pandas",
    ) -> Any:  # noqa: ANN401 - a frame of that library
        """Return the map over two axes as a data frame: U, dp, T, Q, lower, upper, extrapolated.

        Parameters
        ----------
        U, dp
            Axes, % and bar; by default the range of U, and the drops of the samples.
        backend
            ``pandas``, ``polars`` or ``pyarrow``.
        """
        from valvemap.storage.tables import data_frame  # noqa: PLC0415 - an extra

        U = np.linspace(*U_range_of(self.estimator), LEVELS_U) if U is None else U
        dp = np.linspace(*self._drops(), LEVELS_DP) if dp is None else dp
        grid_U, grid_dp = np.meshgrid(_numbers("U", U), _numbers("dp", dp), indexing="ij")
        given, _ = self._points(None, U=grid_U, dp=grid_dp)
        Q, std, guessed = self._predicted(given)
        half = TWO_SIDED_95 * np.hypot(std, self.noise_std)
        table = dict(zip(("U", "dp", "T"), given, strict=True))
        table |= {"Q": Q, "lower": Q - half, "upper": Q + half, "extrapolated": guessed}
        return data_frame(table, backend)

    def save(self, file: str | os.PathLike[str]) -> None:
        """Save as JSON; :func:`valvemap.open_model` reads it back to the same bits.

        Raises
        ------
        ConfigurationError
            if the name does not end in .json.
        StorageError
            if the file cannot be written.
        """
        if not is_model(Path(file)):
            raise ConfigurationError(f"{file}: the name of a saved model ends in .json")
        write_model(Path(file), self)

    def _drops(self) -> tuple[float, float]:
        """Return the least and the largest pressure drop of the samples, bar, from 0 on."""
        boxes = self.support.boxes
        if not len(boxes):
            return max(float(self.support.ranges[2]), 0.0), float(self.support.ranges[3])
        lows, highs = boxes[:, 3], boxes[:, 4]
        return max(float(lows.min()), 0.0), float(highs.max())

    def _title(self) -> str:
        oil = "oil temperature unknown" if np.isnan(self.T) else f"oil at {self.T:.3g} °C"
        return f"{self.valve} by {self.name}, {oil}"

    def _points(self, T: ArrayLike | None, **given: ArrayLike) -> tuple[Points, tuple[int, ...]]:
        """Return both arguments and T as (N,), and the shape in which they broadcast."""
        arrays = [_numbers(name, x) for name, x in given.items()]
        arrays.append(np.atleast_1d(np.float64(self.T)) if T is None else _numbers("T", T))
        try:
            shape = np.broadcast_shapes(*(x.shape for x in arrays))
        except ValueError:
            said = ", ".join(f"{n} {x.shape}" for n, x in zip((*given, "T"), arrays, strict=True))
            raise ConfigurationError(f"shapes that broadcast are allowed, not {said}") from None
        first, dp, warm = (np.broadcast_to(x, shape).flatten() for x in arrays)
        return (first, dp, warm), shape

    def _predicted(self, points: Points) -> tuple[Floats, Floats, Any]:
        """Return flow, standard deviation of the map, and whether it is extrapolated, (N,)."""
        Q, std = self.estimator.predict(self.state, *points)
        return Q, *trusted(self.estimator, self.state, self.support, points, Q, std)

    def _shared_points(self, other: StoredModel) -> tuple[Points, Floats]:
        """Return points that neither map extrapolates, and the other's flow there."""
        lows, highs = (np.array([m.support.ranges for m in (self, other)])[:, k] for k in (2, 3))
        U = np.linspace(*U_range_of(self.estimator), 4 * LEVELS_U)
        dp = np.linspace(max(lows.max(), 0.0), highs.min(), 4 * LEVELS_DP)
        grid_U, grid_dp = np.meshgrid(U, dp, indexing="ij")
        given, _ = self._points(None, U=grid_U, dp=grid_dp)
        theirs = Model(**vars(other))
        Q, _, guessed = theirs._predicted(given)
        return given, np.where(guessed | self._predicted(given)[2], np.nan, Q)

    def _measured(self, given: object, layout: Any) -> tuple[Points, Floats]:  # noqa: ANN401
        parts, found = [], dict[str, None]()
        from valvemap.storage.recordings import read_recording  # noqa: PLC0415 - only to compare

        for recording in recordings_in(given):
            with read_recording(recording, layout=layout) as batches:
                for valve, samples in batches:
                    found[valve] = None
                    if valve == self.valve:
                        parts.append(samples[samples.quality != Quality.BAD])
        if not parts:
            raise ConfigurationError(
                f"the recording holds no valve {self.valve!r}; it holds {', '.join(found)}"
            )
        whole = Samples.concatenate(parts)
        return (whole.U, whole.dp, whole.T), whole.Q


def _numbers(name: str, given: ArrayLike) -> Floats:
    """Return an argument as numbers of at least one dimension."""
    try:
        if given is None or np.asarray(given).dtype.kind in "mM":
            raise TypeError  # noqa: TRY301 - numpy would return NaN, or a count of days
        return np.atleast_1d(np.asarray(without_mask(given), np.float64))
    except (TypeError, ValueError):
        raise ConfigurationError(
            f"{name} is {shown(given)}; a number, or an array of numbers, is allowed"
        ) from None
