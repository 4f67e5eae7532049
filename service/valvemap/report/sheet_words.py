"""The texts of a valve's sheet, for terminal and page."""

import math
from typing import Final

from valvemap.model.judged_sheet import Apart, Line
from valvemap.model.sheet import Measured, Sheet

HEADINGS: Final = ("figure", "value", "95 % interval", "unit", "datasheet", "verdict")
"""Of what `cells` returns."""


def notes_of(sheet: Sheet, apart: Apart | None) -> list[str]:
    """Sentences about the conditions, and another map beside."""
    c = sheet.conditions
    pace = f" at {c.pace:.3g} % per s" if c.traverses else ""
    taken = (
        f"All figures hold at {sheet.dp_rated:g} bar. The recording has {c.samples:,} samples in "
        f"{c.duration:.0f} s, U from {c.U[0]:.3g} to {c.U[1]:.3g} %, {c.traverses} traverses"
        f"{pace}, Δp from {c.dp[0]:.3g} to {c.dp[1]:.3g} bar."
    )
    oil = "The oil's temperature was not measured."
    if math.isfinite(c.T[0]):
        oil = f"The oil had {c.T[0]:.3g} to {c.T[1]:.3g} °C."
    fitted = (
        f"A flow scatters by {sheet.fit.noise:.2g} l/min about the curve; the spool and the meter "
        f"lag U by {1000.0 * sheet.fit.lag:.0f} ms."
    )
    names = "Names follow ISO 10770-1 and -2; each definition says where it departs from them."
    found = [taken, oil, fitted, names]
    if apart is not None:
        found.append(
            f"Curve less {apart.name}: {apart.mean:+.2g} l/min in the mean, {apart.largest:+.2g} "
            f"at most, at {apart.at_U:.3g} %."
        )
    return found


def cells(line: Line) -> tuple[str, ...]:
    """Texts of a figure: name, value, interval or reason, unit, datasheet, verdict.

    The datasheet's text is its value, then the tolerances.
    """
    figure = line.figure
    name = f"{figure.name}, {figure.side}" if figure.side else figure.name
    expected = ", ".join(filter(None, (_datasheet(line), _tolerance(line))))
    verdict = str(line.verdict or "")
    if figure.measured is not Measured.MEASURED:
        return name, str(figure.measured), figure.reason, figure.unit, expected, verdict
    interval = f"{figure.lower:.4g} … {figure.upper:.4g}"
    return name, f"{figure.value:.4g}", interval, figure.unit, expected, verdict


def _datasheet(line: Line) -> str:
    return "" if line.datasheet is None else f"{line.datasheet:.4g}"


def _tolerance(line: Line) -> str:
    least, most = (f"{x:.4g}" if math.isfinite(x) else "" for x in (line.least, line.most))
    if least and most:
        return f"{least} … {most}"
    return f"≥ {least}" if least else f"≤ {most}" if most else ""
