"""A valve's sheet from its recording, judged by a datasheet, compared with an approved map."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from valvemap.app.models import open_model
from valvemap.app.valve_dynamics import as_json as dynamics_as_json
from valvemap.app.valve_dynamics import dynamics_of
from valvemap.app.valve_samples import samples_of
from valvemap.config.datasheet import Datasheet
from valvemap.errors import ConfigurationError, RecordingError
from valvemap.model.dynamics import Dynamics
from valvemap.model.judged_sheet import Apart, Line, Verdict, compare, judge
from valvemap.model.samples import Floats
from valvemap.model.sheet import Figure, Sheet, SheetError, make_sheet, too_few_traverses
from valvemap.model.sheet_figures import names_of
from valvemap.storage.commission_files import why_unfinished
from valvemap.storage.layout import Layout
from valvemap.storage.models import is_model

_NOISE_PERCENT: Final = 1.0  # of a signal at 0


class Other(NamedTuple):
    """Another map: its name, and its flow at U (N,) and one Δp."""

    name: str
    predict: Callable[[Floats, float], Floats]


@dataclass(frozen=True)
class JudgedSheet:
    """A sheet, its comparison with a datasheet and another map, and the recorded dynamics."""

    valve: str
    file: Path
    sheet: Sheet
    lines: tuple[Line, ...]
    apart: Apart | None
    dynamics: tuple[Path, Dynamics] | None = None

    @property
    def fails(self) -> bool:
        """Whether a figure is certainly out of its tolerance."""
        return any(line.verdict is Verdict.FAIL for line in self.lines)


def sheet_of(
    valve: str,
    file: Path,
    layout: Layout | None,
    datasheet: Datasheet,
    dp_rated: float,
    U_range: tuple[float, float] | None,
    against: Other | None = None,
    steps: Path | None = None,
) -> JudgedSheet:
    """Make the sheet of a valve from a recording.

    Parameters
    ----------
    U_range
        Rated signal, %; None: 0 to 100 if U never is below 0, else the user is asked.
    against
        Another map, with which the curve is compared.
    steps
        A recording that tells the dynamics; None: the sheet is without them.

    Raises
    ------
    RecordingError
        naming the file, and why it tells no sheet.
    ConfigurationError, StorageError
    """
    samples = samples_of(valve, file, layout)
    if U_range is None:
        lowest = float(samples.U[np.isfinite(samples.U)].min(initial=0.0))
        if lowest < -_NOISE_PERCENT:
            raise ConfigurationError(
                f"{file}: U falls to {lowest:.3g} %; say --both-ways if the valve works both ways, "
                "--one-way if its range is 0 to 100 %"
            )
        U_range = 0.0, 100.0
    _check_has(datasheet, U_range)
    try:
        sheet = make_sheet(samples, dp_rated, U_range)
    except SheetError as error:
        raise RecordingError(f"{file}: {error}") from None
    unfinished = why_unfinished(file)
    if unfinished is not None:  # its moves between the traverses are no work
        sheet = replace(sheet, not_a_test=too_few_traverses(sheet.conditions) or unfinished)
    lines = tuple(_line(figure, datasheet) for figure in sheet.figures)
    apart = None
    if against is not None:
        apart = compare(sheet, against.name, against.predict(sheet.fit.x, dp_rated))
        if apart is None:
            raise ConfigurationError(f"{against.name} knows no flow at {dp_rated:g} bar")
    dynamics = None if steps is None else (steps, dynamics_of(valve, steps, layout))
    return JudgedSheet(valve, file, sheet, lines, apart, dynamics)


def saved_map(file: Path, valve: str) -> Other:
    """Return a saved model as a map to compare with.

    Raises
    ------
    ConfigurationError, StorageError
    """
    if not is_model(file):
        raise ConfigurationError(
            f"--against {file}: a saved map (.json) is needed; `valvemap replay RECORDING --save "
            "MODEL.json` makes one"
        )
    model = open_model(file, valve=valve)
    return Other(f"{file.name} ({model.name})", model.predict)


def _check_has(datasheet: Datasheet, U_range: tuple[float, float]) -> None:
    """Refuse what the datasheet expects of figures that the valve has not."""
    has = names_of(sum(end != 0.0 for end in U_range))
    for key in datasheet.figures:
        if key not in has:
            raise ConfigurationError(
                f"datasheet: figures.{key}: a valve that works one way has no "
                f"{names_of(2)[key]}; remove it, or say --both-ways"
            )


def _line(figure: Figure, datasheet: Datasheet) -> Line:
    expected = datasheet.figures.get(figure.key)
    if expected is None:
        return Line(figure)
    least, most = expected.min, expected.max
    if math.isinf(least) and math.isinf(most):
        return Line(figure, expected.value)
    return Line(figure, expected.value, judge(figure, least, most), least, most)


def as_json(judged: JudgedSheet) -> dict[str, Any]:
    """Return what ``--json`` writes; numbers that are not finite are null."""
    sheet = judged.sheet
    low, high = sheet.fit.interval()
    apart = judged.apart
    found: dict[str, Any] = {
        "valve": judged.valve,
        "recording": judged.file.name,
        "is_a_test": not sheet.not_a_test,
        "not_a_test": sheet.not_a_test,
        "rated_dp_bar": sheet.dp_rated,
        "conditions": asdict(sheet.conditions),
        "figures": [
            {
                **asdict(line.figure),
                "datasheet": line.datasheet,
                "min": line.least,
                "max": line.most,
                "verdict": line.verdict,
            }
            for line in judged.lines
        ],
        "curve": {
            "x": sheet.fit.x.tolist(),
            "Q": sheet.fit.Q.tolist(),
            "lower": low.tolist(),
            "upper": high.tolist(),
            "known": sheet.fit.known.tolist(),
        },
        "compared_with": None
        if apart is None
        else {
            "map": apart.name,
            "mean": apart.mean,
            "largest": apart.largest,
            "at_U": apart.at_U,
        },
        "dynamics": None
        if judged.dynamics is None
        else dynamics_as_json(judged.valve, *judged.dynamics),
    }
    return {key: _finite(value) for key, value in found.items()}


def _finite(value: Any) -> Any:  # noqa: ANN401 - any JSON value
    if isinstance(value, dict):
        return {key: _finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
