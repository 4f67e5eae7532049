"""Pictures of a replay, collected in constant memory while it runs."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from valvemap.model.samples import Floats, Samples, Trace
from valvemap.pipeline.valve_state import Lane
from valvemap.report.plots import plot_agreement, plot_map, plot_residuals
from valvemap.report.thinning import Thinned
from valvemap.vocabulary.statuses import Quality

_GRID = 60


class ReplayPlots:
    """Collects what the estimators said, thinned evenly, and draws it at the end.

    Parameters
    ----------
    folder
        Where the PNG files go; made where it is missing.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._valves: dict[str, Thinned] = {}

    def take(self, valve: str, samples: Samples, traces: Mapping[str, Trace]) -> None:
        """Add one batch, with every estimator's trace of it."""
        good = samples.quality != Quality.BAD
        columns = {"t": samples.t, "U": samples.U, "dp": samples.dp, "Q": samples.Q}
        residuals = {f"e {name}": trace.residual for name, trace in traces.items()}
        kept = {name: column[good] for name, column in {**columns, **residuals}.items()}
        self._valves.setdefault(valve, Thinned()).add(kept)

    def write(self, lanes: Mapping[str, Mapping[str, Lane]]) -> Iterator[Path]:
        """Draw everything; tell each file as it is written.

        Parameters
        ----------
        lanes
            Valve → estimator → its final state, for the maps.

        Raises
        ------
        StorageError
            naming the file.
        """
        for valve, thinned in self._valves.items():
            kept = thinned.columns
            if not len(kept["t"]):  # not one good sample
                continue
            residuals = {n.removeprefix("e "): e for n, e in kept.items() if n.startswith("e ")}
            agreement = self._folder / f"{valve}-agreement.png"
            plot_agreement(agreement, kept["Q"], {n: kept["Q"] - e for n, e in residuals.items()})
            yield agreement
            over_time = self._folder / f"{valve}-residuals.png"
            plot_residuals(over_time, kept["t"], residuals)
            yield over_time
            for name, lane in lanes[valve].items():
                file = self._folder / f"{valve}-map-{_file_name(name)}.png"
                U, dp = _axis(kept["U"]), _axis(kept["dp"])
                plot_map(file, U, dp, _map(lane, U, dp), (kept["U"], kept["dp"]))
                yield file


def _axis(column: Floats) -> Floats:
    return np.linspace(column.min(), column.max(), _GRID)


def _map(lane: Lane, U: Floats, dp: Floats) -> Floats:
    grid_U, grid_dp = (g.ravel() for g in np.meshgrid(U, dp, indexing="ij"))
    T = np.full(grid_U.shape, np.nan)
    Q, _ = lane.estimator.predict(lane.state, grid_U, grid_dp, T)
    return Q.reshape(len(U), len(dp))


def _file_name(estimator: str) -> str:
    return "".join(c for c in estimator if c.isalnum() or c in "-_")
