"""A valve's sheet as one HTML page that stands alone, with its flow curve as a picture."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Picture

from valvemap.model.dynamics import Dynamics
from valvemap.model.judged_sheet import Apart, Line
from valvemap.model.sheet import Sheet
from valvemap.report.dynamics_page import dynamics_part
from valvemap.report.plots import COLOURS
from valvemap.report.sheet_words import HEADINGS, cells, notes_of
from valvemap.report.standalone_page import as_svg, write_page

_STYLE = """th, td { vertical-align: top }
td:last-child { color: #4d5963; font-size: .85rem; max-width: 26rem }
.fail td:nth-child(6) { color: #a4001d; font-weight: 600 }
.pass td:nth-child(6) { color: #00632b }
.what { font-weight: 600; color: #a4001d }
@media print { body { margin: 0; font-size: 12px } }"""


def write_sheet(
    file: Path,
    title: str,
    sheet: Sheet,
    lines: Sequence[Line],
    apart: Apart | None,
    dynamics: tuple[str, Dynamics] | None = None,
) -> None:
    """Write the page.

    Parameters
    ----------
    title
        Whose sheet it is.
    lines
        The figures, with datasheet and verdicts.
    apart
        Another map, drawn beside the curve; None without one.
    dynamics
        The recording they come from, and the dynamics; None: they were not measured.

    Raises
    ------
    StorageError
        naming the file.
    """
    what = escape(sheet.not_a_test and f"Not a test: {sheet.not_a_test}.")
    head = "".join(f"<th>{heading}</th>" for heading in (*HEADINGS, "definition"))
    rows = "\n".join(map(_row, lines))
    notes = "\n".join(f"<li>{escape(note)}</li>" for note in notes_of(sheet, apart))
    body = (
        f'<p class="what">{what}</p>\n<table><thead><tr>{head}</tr></thead><tbody>\n{rows}\n'
        f"</tbody></table>\n{_picture(sheet, apart)}\n<ul>\n{notes}\n</ul>"
    )
    if dynamics is not None:
        source, found = dynamics
        body += f"\n<h2>Dynamics from {escape(source)}</h2>\n{dynamics_part(found)}"
    write_page(file, escape(title), body, _STYLE)


def _row(line: Line) -> str:
    texts = (*cells(line), line.figure.definition)
    kind = f' class="{line.verdict}"' if line.verdict else ""
    return f"<tr{kind}>" + "".join(f"<td>{escape(text)}</td>" for text in texts) + "</tr>"


def _picture(sheet: Sheet, apart: Apart | None) -> str:
    fit = sheet.fit
    figure = Picture(figsize=(8.0, 4.6), layout="constrained")
    axes = figure.add_subplot()
    half = 0.5 * fit.play
    Q = np.where(fit.known, fit.Q, np.nan)
    low, high = fit.interval()
    axes.plot(fit.x + half, Q, color=COLOURS[0], linewidth=1.4, label="U rising")
    axes.plot(fit.x - half, Q, color=COLOURS[1], linewidth=1.4, label="U falling")
    for shift, colour in ((half, COLOURS[0]), (-half, COLOURS[1])):
        axes.fill_between(
            fit.x + shift, low, high, where=fit.known, color=colour, alpha=0.15, linewidth=0
        )
    if apart is not None:
        axes.plot(fit.x, apart.Q, color="#555555", linewidth=1.2, linestyle="--", label=apart.name)
    axes.grid(visible=True, color="#dddddd", linewidth=0.6)
    axes.set(xlabel="U, %", ylabel=f"Q at {sheet.dp_rated:g} bar, l/min")
    axes.legend(fontsize=9)
    return as_svg(figure)
