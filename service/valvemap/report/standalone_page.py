"""HTML pages that stand alone: style and pictures are in the file."""

import io
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

from valvemap.owned_files import write_whole
from valvemap.report.page_style import STYLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure  # of an extra


def write_page(file: Path, title: str, body: str, style: str = "") -> None:
    """Write a page; ``title`` and ``body`` are HTML, ``style`` comes after the common one.

    Raises
    ------
    StorageError
        naming the file.
    """
    write_whole(file, _PAGE.substitute(title=title, body=body, style=f"{STYLE}\n{style}"))


def as_svg(figure: "Figure") -> str:
    """Return a picture as an SVG element."""
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
$body
</body>
</html>
""")
