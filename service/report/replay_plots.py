"""Pictures of a replay, collected in constant memory while it runs."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from service.identification.samples import Floats, Quality, Samples, Trace
from service.report.plots import plot_agreement, plot_residuals

_MOST_POINTS = 20_000


class ReplayPlots:
    """Collects what the estimators said, thinned evenly, and draws it at the end.

    Parameters
    ----------
    folder
        Where the PNG files go; made where it is missing.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._valves: dict[str, _Thinned] = {}

    def take(self, valve: str, samples: Samples, traces: Mapping[str, Trace]) -> None:
        """Take one batch in, with what every estimator said of it."""
        good = samples.quality != Quality.BAD
        rows = np.stack([samples.t.astype(np.float64), samples.Q, *_residuals(traces)], axis=1)
        self._valves.setdefault(valve, _Thinned(list(traces))).add(rows[good])

    def write(self) -> Iterator[Path]:
        """Draw everything; tell each file as it is written.

        Raises
        ------
        StorageError
            naming the file.
        """
        for valve, kept in self._valves.items():
            t, Q, *columns = kept.rows.T
            residuals = dict(zip(kept.names, columns, strict=True))
            agreement = self._folder / f"{valve}-agreement.png"
            plot_agreement(agreement, Q, {name: Q - e for name, e in residuals.items()})
            yield agreement
            over_time = self._folder / f"{valve}-residuals.png"
            plot_residuals(over_time, t.astype(np.int64), residuals)
            yield over_time


class _Thinned:
    """Every k-th row of a stream of any length; k doubles when there are too many."""

    def __init__(self, names: list[str]) -> None:
        self.names = names
        self.rows = np.empty((0, 2 + len(names)))
        self._step = 1
        self._seen = 0

    def add(self, rows: Floats) -> None:
        first = -self._seen % self._step
        self._seen += len(rows)
        self.rows = np.concatenate([self.rows, rows[first :: self._step]])
        while len(self.rows) > _MOST_POINTS:
            self.rows = self.rows[::2]
            self._step *= 2


def _residuals(traces: Mapping[str, Trace]) -> list[Floats]:
    return [trace.residual for trace in traces.values()]
