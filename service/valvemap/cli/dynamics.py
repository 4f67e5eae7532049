"""``valvemap dynamics``: how quickly spool and flow meter follow, from a recording."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from valvemap.cli.options import ConfigOption, ForceOption, new_file
from valvemap.cli.output import terminal, write_line
from valvemap.cli.progress import working

if TYPE_CHECKING:
    from valvemap.model.dynamics import Dynamics


def dynamics(
    valve: Annotated[str, typer.Argument(metavar="VALVE", help="Name of the valve.")],
    recording: Annotated[
        Path,
        typer.Option(
            "--from",
            metavar="FILE",
            help="Recording at 100 Hz or more: steps, PRBS or machine work.",
        ),
    ],
    config: ConfigOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.html",
            help="Write a page with step response and Bode plot.",
            callback=new_file,
        ),
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write all of it as JSON.", callback=new_file),
    ] = None,
    *,
    force: ForceOption = False,
) -> None:
    """Print a valve's dynamics: natural frequency, damping, slew, dead time, meter lag, T90."""
    from valvemap.app.valve_dynamics import dynamics_of

    layout = None
    if config is not None:
        from valvemap.app.build import build_layout
        from valvemap.config.loading import load_config

        layout = build_layout(load_config(config))
    with working(f"{recording.name}: fitting spool and meter"):
        found = dynamics_of(valve, recording, layout)
    show_dynamics(f"{valve}: spool and flow meter", found)
    if json_file is not None:
        from valvemap.app.valve_dynamics import as_json
        from valvemap.cli.replay import write_json

        write_json(json_file, as_json(valve, recording, found))
        write_line(f"written: {json_file}")
    if out is not None:
        from valvemap.report.dynamics_page import write_dynamics  # matplotlib is an extra

        write_dynamics(out, f"{valve}: dynamics from {recording.name}", found)
        write_line(f"written: {out}")


def show_dynamics(title: str, found: "Dynamics") -> None:
    """Print quantities and notes."""
    from valvemap.report.dynamics_words import HEADINGS, notes_of, rows_of

    table = Table(title=title, title_justify="left")
    for heading in HEADINGS:
        table.add_column(heading, justify="right" if heading == "value" else "left")
    for row in rows_of(found):
        table.add_row(*row)
    terminal().print(table)
    for note in notes_of(found):
        write_line(note)
