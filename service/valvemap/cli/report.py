"""``valvemap report``: reproduces the paper. Its code is in the repository only."""

import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from valvemap.cli.options import ForceOption, new_pages
from valvemap.errors import ValvemapError

REPOSITORY = Path(__file__).parents[3]  # root of a clone


def report(
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR", help="Where paper.html, paper.json and pictures go.", callback=new_pages
        ),
    ] = Path("reports"),
    sets: Annotated[
        int, typer.Option(min=1, max=50, help="Sets of recordings; the median is judged.")
    ] = 5,
    rate: Annotated[
        float,
        typer.Option(min=2.0, max=20.0, metavar="HZ", help="Samples per second; and ten times it."),
    ] = 10.0,
    *,
    force: ForceOption = False,
) -> None:
    """Rebuild the paper's figures and tables, and judge its claims (in a clone)."""
    if not (REPOSITORY / "paper" / "command.py").is_file():
        raise ValvemapError(
            "report: the paper's reproduction is not part of the installed package; "
            "clone the repository and run `make report` there"
        )
    sys.path.append(str(REPOSITORY))
    import_module("paper.command").rebuild(out, sets, rate)
