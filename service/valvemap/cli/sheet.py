"""``valvemap sheet``: the figures of a valve, from a guided sweep."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.table import Table

from valvemap.cli.options import ConfigOption, FolderOption, ForceOption, new_file
from valvemap.cli.output import terminal, write_line
from valvemap.cli.progress import working
from valvemap.errors import ConfigurationError

if TYPE_CHECKING:
    from valvemap.app.valve_sheet import JudgedSheet, Other
    from valvemap.storage.layout import Layout

_RATED_BAR: Final = 70.0  # 35 bar for each edge


def sheet(
    valve: Annotated[str, typer.Argument(metavar="VALVE", help="Name of the valve.")],
    recording: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="FILE",
            help="Recording of a sweep.  [default: the valve's last `commission`]",
        ),
    ] = None,
    config: ConfigOption = None,
    dp: Annotated[
        float | None,
        typer.Option(
            "--rated-dp", min=0.1, metavar="BAR", help="Δp of the figures.  [default: 70]"
        ),
    ] = None,
    datasheet: Annotated[
        Path | None,
        typer.Option(metavar="FILE.toml", help="Values of the datasheet, and tolerances."),
    ] = None,
    against: Annotated[
        Path | None,
        typer.Option(metavar="MODEL.json", help="A saved map to compare the curve with."),
    ] = None,
    steps: Annotated[
        Path | None,
        typer.Option(
            "--dynamics",
            metavar="FILE",
            help="Recording of steps at 100 Hz or more: adds dynamics, step response, Bode plot.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Write the sheet as a page.", callback=new_file),
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the sheet as JSON.", callback=new_file),
    ] = None,
    data: FolderOption = Path("data"),
    *,
    approved: Annotated[
        bool,
        typer.Option(
            "--approved", help="Compare the curve with the approved map of the service of --config."
        ),
    ] = False,
    both_ways: Annotated[
        bool | None,
        typer.Option(
            "--both-ways/--one-way", help="Whether U is -100 to 100 %; --config says so, too."
        ),
    ] = None,
    force: ForceOption = False,
) -> None:
    """Print a valve's sheet: rated flow, dead band, hysteresis and more, with intervals."""
    from valvemap.app.valve_sheet import saved_map, sheet_of
    from valvemap.cli.replay import write_json
    from valvemap.config.datasheet import Datasheet, read_datasheet

    expected = Datasheet() if datasheet is None else read_datasheet(datasheet)
    file = recording or _last_commission(data, valve)
    layout, U_range = _configured(config, valve)
    if both_ways is not None:
        U_range = (-100.0 if both_ways else 0.0), 100.0
    other = None if against is None else saved_map(against, valve)
    if approved:
        if against is not None:
            raise ConfigurationError("--approved: not with --against; the sheet has one comparison")
        other = _approved(config, valve)
    rated = dp or expected.rated_dp_bar or _RATED_BAR
    with working(f"{file.name}: fitting the curve"):
        judged = sheet_of(valve, file, layout, expected, rated, U_range, other, steps)
    _show(judged)
    if json_file is not None:
        from valvemap.app.valve_sheet import as_json

        write_json(json_file, as_json(judged))
        write_line(f"written: {json_file}")
    if out is not None:
        from valvemap.report.sheet_page import write_sheet  # matplotlib is an extra

        title = f"{valve}: sheet from {file.name}"
        found = judged.dynamics
        dynamics = None if found is None else (found[0].name, found[1])
        write_sheet(out, title, judged.sheet, judged.lines, judged.apart, dynamics)
        write_line(f"written: {out}")
    if judged.fails:
        raise typer.Exit(1)


def _last_commission(data: Path, valve: str) -> Path:
    from valvemap.storage.commission_files import last_sampled_run

    found = last_sampled_run(data / "commission", valve)
    if found is None:
        raise ConfigurationError(
            f"VALVE {valve!r}: {data / 'commission'} holds no run of it with samples; "
            "name a recording with --from, or run `valvemap commission`"
        )
    return found


def _approved(config: Path | None, valve: str) -> "Other":
    """Return the approved map of the configured service."""
    if config is None:
        raise ConfigurationError("--approved: --config is needed, too; it names the service")
    from valvemap.app.approved_map import approved_map
    from valvemap.app.valve_sheet import Other
    from valvemap.config.loading import load_config

    found = approved_map(load_config(config), valve)
    return Other(found.name, found.predict)


def _configured(
    config: Path | None, valve: str
) -> "tuple[Layout | None, tuple[float, float] | None]":
    """Return the recording's layout and the valve's rated signal; None without --config."""
    if config is None:
        return None, None
    from valvemap.app.build import build_layout
    from valvemap.config.loading import config_of, load_config

    loaded = load_config(config)
    (own,) = config_of(loaded, valve).valves
    return build_layout(loaded), own.U_range_percent


def _show(judged: "JudgedSheet") -> None:
    from valvemap.report.sheet_words import HEADINGS, cells, notes_of

    sheet = judged.sheet
    judges = any(line.datasheet is not None or line.verdict for line in judged.lines)
    headings = HEADINGS if judges else HEADINGS[: HEADINGS.index("datasheet")]
    table = Table(title=f"{judged.valve} at {sheet.dp_rated:g} bar", title_justify="left")
    for heading in headings:
        table.add_column(heading, justify="right" if heading == "value" else "left")
    for line in judged.lines:
        table.add_row(*cells(line)[: len(headings)])
    terminal().print(table)
    if sheet.not_a_test:
        write_line(f"Not a test: {sheet.not_a_test}.")
    for note in notes_of(sheet, judged.apart):
        write_line(note)
    if judged.dynamics is not None:
        from valvemap.cli.dynamics import show_dynamics

        file, found = judged.dynamics
        show_dynamics(f"{judged.valve}: dynamics from {file.name}", found)
