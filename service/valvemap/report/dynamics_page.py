"""A valve's dynamics as one HTML page that stands alone, with step response and Bode plot."""

from html import escape
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Picture

from valvemap.model.dynamics import Dynamics
from valvemap.report.dynamics_words import HEADINGS, notes_of, rows_of
from valvemap.report.plots import COLOURS
from valvemap.report.standalone_page import as_svg, write_page
from valvemap.vocabulary.statuses import Status


def write_dynamics(file: Path, title: str, found: Dynamics) -> None:
    """Write the page.

    Raises
    ------
    StorageError
        naming the file.
    """
    write_page(file, escape(title), dynamics_part(found))


def dynamics_part(found: Dynamics) -> str:
    """Return table, step response, Bode plot and notes as HTML."""
    rows = ("".join(f"<td>{escape(text)}</td>" for text in row) for row in rows_of(found))
    head = "".join(f"<th>{heading}</th>" for heading in HEADINGS)
    body = "\n".join(f"<tr>{row}</tr>" for row in rows)
    notes = "\n".join(f"<li>{escape(note)}</li>" for note in notes_of(found))
    picture = _picture(found) if found.T90.status is Status.OK else ""
    return (
        f"<table><thead><tr>{head}</tr></thead><tbody>\n{body}\n</tbody></table>\n"
        f"{picture}\n<ul>\n{notes}\n</ul>"
    )


def _picture(found: Dynamics) -> str:
    """Return step response, magnitude and phase, as SVG."""
    figure = Picture(figsize=(9.0, 4.2), layout="constrained")
    places = figure.subplot_mosaic([["step", "magnitude"], ["step", "phase"]])
    natural = found.natural_frequency.value
    t, x = found.step_response(max(3.0 * found.T90.value, 1.5 / natural))
    step = places["step"]
    step.axhline(found.step_percent, color="#888888", linewidth=0.8)
    step.plot(1e3 * t, x, color=COLOURS[0], linewidth=1.4)
    step.plot(1e3 * found.T90.value, 0.9 * found.step_percent, "o", color=COLOURS[1], label="T90")
    step.set(xlabel="t, ms", ylabel="spool, % of U", title=f"step of {found.step_percent:.3g} %")
    step.legend(fontsize=9)
    f = np.geomspace(0.05 * natural, 5.0 * natural, 200)
    for name, values, unit in zip(
        ("magnitude", "phase"), found.frequency_response(f), ("dB", "°"), strict=True
    ):
        place = places[name]
        place.semilogx(f, values, color=COLOURS[0], linewidth=1.4)
        place.axvline(natural, color="#888888", linewidth=0.8)
        place.set(ylabel=f"{name}, {unit}")
    places["magnitude"].set(title="small movements")
    places["phase"].set(xlabel="f, Hz")
    for place in places.values():
        place.grid(visible=True, color="#dddddd", linewidth=0.6)
    return as_svg(figure)
