"""Models for use outside the service: loaded from a file, or identified from a recording."""

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from valvemap.app.flow_model import Model
from valvemap.app.given import name_in, rating_of, recordings_in
from valvemap.errors import ConfigurationError, RecordingError
from valvemap.model.extrapolation import ranges_of
from valvemap.owned_files import make_folder
from valvemap.plant.evidence import RATED_DROP_BAR
from valvemap.storage.models import is_model, load_model, save_model

if TYPE_CHECKING:
    from valvemap.app.recording_batches import Note, Progress
    from valvemap.app.replay_report import Report
    from valvemap.config.models import Config

PREFERRED: Final = "Auto"
BEYOND: Final = 0.01  # share of the samples that a fit may leave out: beyond its ranges


def fit(
    recordings: object,
    *,
    units: Mapping[str, str] | None = None,
    columns: Mapping[str, str] | None = None,
    U_range: tuple[float, float] | None = None,
    dp_range: tuple[float, float] | None = None,
    rated_flow: float = 0.0,
    rated_drop: float = RATED_DROP_BAR,
    valve: str | None = None,
    estimator: str | None = None,
    config: "Config | str | os.PathLike[str] | None" = None,
    insist: bool = False,
    progress: "Progress" = lambda _file, _fraction: None,
    note: "Note | None" = None,
) -> Model:
    """Identify one valve's map, as the service would from the same samples.

    Parameters
    ----------
    recordings
        A path (CSV, Parquet), a data frame (pandas, polars, pyarrow; extra ``dataframes``), a dict
        of arrays by column, a structured array, a list of rows (dicts), or a list of the others, in
        the order of time. Columns are t, U, p1, p2, Q and optionally T, valve, quality; see
        :func:`valvemap.read_recording`.
    units
        Units that differ from %, bar, l/min, °C, by signal: ``{"p1": "psi", "Q": "gpm"}``; raw
        numbers and their values: ``{"U": "4..20:0..100%"}``; of times that are not in s:
        ``{"t": "ms"}``. Units that the values contradict are refused.
    columns
        Columns with other names, by signal: ``{"t": "Time", "U": "Control signal"}``.
    U_range
        Range of U in %, if it is not (0, 100): (-100, 100) of a valve that works both ways.
    dp_range
        Range of p1 - p2 in bar; by default (0, 200), or wider where the first samples need it.
    rated_flow, rated_drop
        Of the name plate: flow at U = 100 %, l/min (0: unknown), and its pressure drop, bar. A unit
        of Q that they contradict is refused.
    valve, estimator
        Valve and estimator; by default a recording's only valve, and the recommended estimator
        (else Auto or the first). With an estimator, the others do not run.
    config
        Configuration, or its path: valves and estimators, columns and units.
    insist
        Process implausible signals, too.
    progress
        Called with a recording and the fraction done (0 to 1).
    note
        Called with one line for each omitted part, as by :func:`valvemap.replay`; None: a warning.

    Raises
    ------
    RecordingError
        if a recording cannot be read, or nothing can be learnt from it; names it.
    ConfigurationError
        if there is no such valve, estimator, unit or column, or the choice is ambiguous.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> U, dp = rng.uniform(0, 100, 2000), rng.uniform(5, 200, 2000)
    >>> rows = {"t": np.arange(2000), "U": U, "p1": dp, "p2": 0 * dp, "Q": 0.1 * U * np.sqrt(dp)}
    >>> fit(rows, estimator="RLS").predict(50.0, [25.0, 100.0]).round(6)
    array([25., 50.])
    """
    from valvemap.app.recording_batches import (  # noqa: PLC0415 - a saved map needs none of it
        as_warning,
    )
    from valvemap.app.replay import replay  # noqa: PLC0415
    from valvemap.app.replay_report import (  # noqa: PLC0415
        refuse_if_nothing_was_learnt,
    )

    given, only = recordings_in(recordings), name_in("valve", valve)
    for file in given:
        if isinstance(file, Path) and is_model(file):
            raise ConfigurationError(f"{file} is a saved model: valvemap.open_model opens it")
    report = replay(
        given,
        config,
        progress=progress,
        only=only,
        estimators=name_in("estimator", estimator),
        insist=insist,
        units=units,
        columns=columns,
        U_range=U_range,
        dp_range=dp_range,
        rating=rating_of(rated_flow, rated_drop),
        note=note or as_warning,
    )
    where = given[0] if isinstance(given[0], Path) else type(given[0]).__name__
    valve = _chosen(where, "valve", valve, list(report))
    refuse_if_nothing_was_learnt({valve: report[valve]})
    names = _recursive(report[valve])
    name = _chosen(where, "estimator", estimator or _preferred(report, valve) or names[0], names)
    found = report[valve][name]
    if found.beyond_range > BEYOND * found.samples and not insist:
        raise RecordingError(
            f"{valve}: U or p1 - p2 is beyond the range of {name} "
            f"({ranges_of(found.lane.estimator)}) in {found.beyond_range:,} of "
            f"{found.samples:,} samples: U_range=(-100, 100) or dp_range=(0, 400), or the valve's "
            "own, covers them; "
            "--insist (insist=True in Python) leaves them out"
        )
    model = Model(
        valve=valve,
        name=name,
        estimator=found.lane.estimator,
        state=found.lane.state,
        noise_std=found.noise_std,
        T=found.T,
        t=found.lane.t,
        samples=found.lane.spread.weights,
        support=found.lane.support,
    )
    _refuse_if_unknown(model, found.lane.count)
    return model


def open_model(
    file: object,
    valve: str | None = None,
    estimator: str | None = None,
    config: "Config | str | os.PathLike[str] | None" = None,
    progress: "Progress" = lambda _file, _fraction: None,
    note: "Note | None" = None,
) -> Model:
    """Load a model (.json), or identify one from recordings, as :func:`fit` does.

    Parameters
    ----------
    file
        A saved model, or recordings to identify from; see :func:`fit`.
    valve, estimator
        Valve and estimator; by default a recording's only valve, and the recommended estimator
        (else Auto or the first).
    config
        Configuration, or its path, for a recording: valves and estimators, columns and units.
    progress, note
        As of :func:`fit`.

    Raises
    ------
    StorageError, RecordingError
        if the file cannot be read; names it.
    ConfigurationError
        if there is no such valve or estimator, or the choice is ambiguous.
    """
    if not isinstance(file, str | os.PathLike) or not is_model(Path(file)):
        return fit(
            file, valve=valve, estimator=estimator, config=config, progress=progress, note=note
        )
    model = Model(**vars(load_model(Path(file))))
    for what, wanted, there in (
        ("valve", valve, model.valve),
        ("estimator", estimator, model.name),
    ):
        if wanted not in (None, there):
            raise ConfigurationError(f"{file}: {what} {wanted!r} is not there; {there} is")
    return model


def save_models(target: Path, report: "Report") -> list[Path]:
    """Save the models of a replay: one (``target`` ends in .json), or all in a folder.

    A single model is that of the only valve, by the recommended estimator, else by `Auto` or the
    only estimator. In a folder each file is named ``<Valve>.<Estimator>.json``; models with
    undetermined parameters are left out.

    Raises
    ------
    StorageError
        if a file or folder cannot be written; names it.
    ConfigurationError
        if ``target`` is one file and there are several valves.
    """
    if is_model(target):
        valve = _chosen(target, "valve", None, list(report))
        names = _recursive(report[valve])
        name = _chosen(target, "estimator", _preferred(report, valve), names)
        return [_save(target, report, valve, name)]
    make_folder(target)
    return [
        _save(target / f"{valve}.{name}.json", report, valve, name)
        for valve, estimators in report.items()
        for name in _recursive(estimators)
        if _is_determined(report, valve, name)
    ]


def _preferred(report: "Report", valve: str) -> str | None:
    """Return the estimator whose map to use: the recommended one, else `Auto`, else unknown."""
    estimators = report[valve]
    recommended = next(iter(estimators.values())).recommended.name
    return recommended or (PREFERRED if PREFERRED in estimators else None)


def _refuse_if_unknown(model: Model, samples: int) -> None:
    """Raise RecordingError if a map is unknown everywhere, naming its number of samples."""
    low_U, high_U, low, high, _ = model.support.ranges
    U, dp = np.meshgrid(np.linspace(low_U, high_U, 9), np.linspace(max(low, 0.0), high, 9))
    if np.isnan(model.predict(U, dp)).all():
        raise RecordingError(
            f"{model.valve}: {samples} samples are too few for a map by {model.name}, "
            "or too much alike"
        )


def _recursive(estimators: Iterable[str]) -> list[str]:
    """Return the names of a replay's estimators, without the batch fit."""
    from valvemap.app.learnt_valve import BEST_FIT  # noqa: PLC0415 - a saved map needs none of it

    return [name for name in estimators if name != BEST_FIT]


def _save(file: Path, report: "Report", valve: str, name: str) -> Path:
    found = report[valve][name]
    lane = found.lane
    rests_on = lane.spread, lane.support
    save_model(file, valve, name, lane.estimator, lane.state, *rests_on, lane.t, found.T)
    return file


def _is_determined(report: "Report", valve: str, name: str) -> bool:
    values = report[valve][name].parameters.values()
    return all(value == value for value in values)  # noqa: PLR0124 - NaN is not itself


def _chosen(file: Path | str, what: str, wanted: str | None, there: Sequence[str]) -> str:
    if wanted is None and len(there) == 1:
        return there[0]
    if wanted in there:
        return str(wanted)
    known = ", ".join(there)
    if wanted is None:
        raise ConfigurationError(f"{file}: which {what}? {known} are there")
    raise ConfigurationError(f"{file}: {what} {wanted!r} is not there; allowed is {known}")
