"""A valve's dynamics as one HTML page that stands alone, with step response and Bode plot."""

import io
from html import escape
from pathlib import Path
from string import Template

import numpy as np
from matplotlib.figure import Figure as Picture

from valvemap.model.dynamics import Dynamics
from valvemap.owned_files import write_whole
from valvemap.report.dynamics_words import HEADINGS, notes_of, rows_of
from valvemap.report.page_style import STYLE
from valvemap.report.plots import COLOURS
from valvemap.vocabulary.statuses import Status


def write_dynamics(file: Path, title: str, found: Dynamics) -> None:
    """Write the page.

    Raises
    ------
    StorageError
        naming the file.
    """
    rows = ("".join(f"<td>{escape(text)}</td>" for text in row) for row in rows_of(found))
    page = _PAGE.substitute(
        title=escape(title),
        style=STYLE,
        head="".join(f"<th>{heading}</th>" for heading in HEADINGS),
        body="\n".join(f"<tr>{row}</tr>" for row in rows),
        notes="\n".join(f"<li>{escape(note)}</li>" for note in notes_of(found)),
        picture=_picture(found) if found.T90.status is Status.OK else "",
    )
    write_whole(file, page)


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
    written = io.StringIO()
    figure.savefig(written, format="svg", metadata={"Date": None})
    text = written.getvalue()
    return text[text.index("<svg") :]


_PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
$style
svg { max-width: 100%; height: auto }
</style>
</head>
<body>
<h1>$title</h1>
<table><thead><tr>$head</tr></thead><tbody>
$body
</tbody></table>
$picture
<ul>
$notes
</ul>
</body>
</html>
""")
