"""What a replay found, as one HTML page that stands alone: pictures inside."""

import base64
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from rich.table import Table

from valvemap.owned_files import naming
from valvemap.report import standalone_page

PAGE = "index.html"
_KINDS = {
    "agreement": "Predicted over measured flow: the fit is good along the line",
    "residuals": "Residuals over time",
    "map": "The map, and where it was measured",
}
_STYLE = """caption { text-align: left; font-weight: 600; padding-bottom: .4rem }
th, td { vertical-align: bottom; white-space: pre-line }
.number { text-align: right }
figure { margin: 2rem 0 }
figcaption { color: #4d5963 }
img { max-width: 100%; height: auto }"""


def write_page(
    folder: Path,
    title: str,
    tables: Iterable[Table],
    notes: Sequence[str],
    pictures: Sequence[Path],
) -> Path:
    """Write the page.

    Parameters
    ----------
    folder
        Where it goes, as ``index.html``.
    title
        The replayed recordings.
    tables
        As they stand in the terminal.
    notes
        Sentences about the data.
    pictures
        PNG files; they are copied into the page.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    StorageError
        naming the file.
    """
    file = folder / PAGE
    with naming(file):
        folder.mkdir(parents=True, exist_ok=True)
        figures = "\n".join(_figure(picture) for picture in pictures)
    shown = "\n".join(map(_table, tables))
    items = "\n".join(f"<li>{escape(note)}</li>" for note in notes)
    body = f"{shown}\n<ul>\n{items}\n</ul>\n{figures}"
    standalone_page.write_page(file, escape(title), body, _STYLE)
    return file


def _table(table: Table) -> str:
    heads = "".join(f"<th{_side(c.justify)}>{escape(str(c.header))}</th>" for c in table.columns)
    rows = zip(*(column.cells for column in table.columns), strict=True)
    body = "\n".join(
        "<tr>"
        + "".join(
            f"<td{_side(column.justify)}>{escape(str(cell))}</td>"
            for column, cell in zip(table.columns, row, strict=True)
        )
        + "</tr>"
        for row in rows
    )
    caption = escape(str(table.title or ""))
    return (
        f"<table><caption>{caption}</caption><thead><tr>{heads}</tr></thead>"
        f"<tbody>{body}</tbody></table>"
    )


def _side(justify: str) -> str:
    return " class=number" if justify == "right" else ""


def _figure(picture: Path) -> str:
    image = base64.b64encode(picture.read_bytes()).decode("ascii")
    valve, _, what = picture.stem.rpartition("-map-")
    kind = "map" if valve else picture.stem.rpartition("-")[2]
    whose = f"{valve}, {what}" if valve else picture.stem.rpartition("-")[0]
    caption = escape(f"{whose}. {_KINDS.get(kind, '')}")
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{image}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )
