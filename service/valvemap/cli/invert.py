"""``valvemap invert`` and ``valvemap export``: the inverse map without a running service."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import numpy as np
import typer
from rich.table import Table

from valvemap.cli.options import ConfigOption, ForceOption, new_file
from valvemap.cli.output import terminal, write_line
from valvemap.cli.progress import bars, of_files, working
from valvemap.errors import ConfigurationError
from valvemap.numba_version import leave_out
from valvemap.vocabulary.statuses import InverseStatus

if TYPE_CHECKING:
    from valvemap.app.flow_model import Model
    from valvemap.config.models import Config
    from valvemap.model.flow_table import FlowTable
    from valvemap.model.inversion import Inversion
    from valvemap.model.lookup_table import LookupTable

MOST_ROWS: Final = 50
FEW: Final = 100  # demands that are answered sooner than numba is imported

FileArgument = Annotated[
    Path, typer.Argument(metavar="FILE", help="Saved model (.json) or a recording to learn from.")
]
ValveOption = Annotated[
    str | None, typer.Option(metavar="NAME", help="Valve, if the recording contains several.")
]
EstimatorOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Whose map of a recording.  [default: recommended]"),
]


def invert(
    file: FileArgument,
    flow: Annotated[
        str | None, typer.Option("--Q", metavar="Q,…", help="Demanded flow, l/min; one or more.")
    ] = None,
    drop: Annotated[
        str | None, typer.Option("--dp", metavar="DP,…", help="Pressure drop, bar; one or more.")
    ] = None,
    temperature: Annotated[
        float | None,
        typer.Option("--T", metavar="°C", help="Oil temperature.  [default: measured last]"),
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option("--from", metavar="CSV", help="Read Q, dp[, T] from this file, line by line."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--to",
            metavar="CSV",
            help="Write Q, dp, T, U, lower, upper, status.",
            callback=new_file,
        ),
    ] = None,
    valve: ValveOption = None,
    estimator: EstimatorOption = None,
    config: ConfigOption = None,
    *,
    force: ForceOption = False,
) -> None:
    """Compute the control voltage for a flow at a pressure drop, with its 95 % interval."""
    from valvemap.storage.points import read_points, write_answers

    if (points is None) == (flow is None or drop is None):
        raise typer.BadParameter("give --Q and --dp, or --from a CSV file")
    if points is not None:
        Q, dp, T = read_points(points)
    else:
        Q, dp = _grid(_numbers("--Q", str(flow)), _numbers("--dp", str(drop)))
        T = np.full_like(Q, np.nan)
    if file.suffix == ".json" and len(Q) <= FEW:
        leave_out()
    from valvemap.app.models import open_model
    from valvemap.model.inverse_map import invert as run

    loaded = _configured(config)
    left_out: list[str] = []
    with bars() as progress:
        model = open_model(file, valve, estimator, loaded, of_files(progress), left_out.append)
    for line in left_out:
        write_line(line)
    T = np.where(np.isnan(T), model.T if temperature is None else temperature, T)
    answer = run(model.estimator, model.state, Q, dp, T, support=model.support)
    if out is not None:
        write_answers(out, (Q, dp, T), answer)
        write_line(f"written: {out}")
        return
    title = f"{model.valve} by {model.name}: U for Q at dp, 95 % interval"
    terminal().print(_table(title, Q, dp, T, answer))


def export(
    file: FileArgument,
    out: Annotated[
        Path,
        typer.Option(
            "--to",
            metavar="FILE",
            help="FILE.csv, .c (C99), .st (IEC 61131-3) or .fmu (FMI 2.0)",
            callback=new_file,
        ),
    ],
    temperature: Annotated[
        float | None,
        typer.Option("--T", metavar="°C", help="Oil temperature.  [default: measured last, or 40]"),
    ] = None,
    points_Q: Annotated[
        int, typer.Option("--points-q", min=2, max=1000, help="Points along the flow.")
    ] = 41,
    points_dp: Annotated[
        int, typer.Option("--points-dp", min=2, max=1000, help="Points along the pressure drop.")
    ] = 31,
    dp_min: Annotated[float, typer.Option(help="Lowest pressure drop, bar.")] = 5.0,
    dp_max: Annotated[float, typer.Option(help="Highest pressure drop, bar.")] = 200.0,
    valve: ValveOption = None,
    estimator: EstimatorOption = None,
    config: ConfigOption = None,
    *,
    force: ForceOption = False,
) -> None:
    """Export the map for a PLC, a program or a simulator: a lookup table with a stated error."""
    from valvemap.app.models import open_model
    from valvemap.model.flow_table import flow_table
    from valvemap.model.lookup_table import lookup_table
    from valvemap.storage import lookup_tables
    from valvemap.storage.flow_tables import write_flow_table

    lookup_tables.check_form(out)
    loaded = _configured(config)
    left_out: list[str] = []
    with bars() as progress:
        model = open_model(file, valve, estimator, loaded, of_files(progress), left_out.append)
    for line in left_out:
        write_line(line)
    T = temperature if temperature is not None else model.T
    T = 40.0 if np.isnan(T) else T
    size = points_Q, points_dp
    try:
        with working("bounding the table's error"):
            table = lookup_table(
                model.estimator,
                model.state,
                dp_max,
                T,
                points=size,
                dp_min=dp_min,
                support=model.support,
            )
    except ValueError as error:
        raise ConfigurationError(f"{file}: {error}") from None
    title = f"{model.valve} by {model.name}"
    shown: LookupTable | FlowTable = table
    match out.suffix.lower():
        case lookup_tables.UNIT:
            _write_unit(out, model, table, title)
        case lookup_tables.CSV:
            shown = flow_table(model.estimator, model.state, table)
            write_flow_table(out, shown, title)
        case _:
            lookup_tables.write_table(out, table, title)
    grounds = "certified" if shown.certified else "measured"
    write_line(
        f"written: {out}: {size[0]} x {size[1]} points at {T:g} °C, within {shown.error_U:.2g} % "
        f"of U and {shown.error_Q:.2g} l/min of the map ({grounds})"
    )
    share = float(np.mean(shown.guessed))
    if share > 0.0:
        write_line(
            f"{share:.0%} of the points are extrapolated, and marked so in the table; a range of "
            "dp that was measured (--dp-min, --dp-max) leaves fewer"
        )


def _write_unit(out: Path, model: "Model", table: "LookupTable", title: str) -> None:
    from valvemap.model.valve_tables import valve_tables
    from valvemap.storage.fmi_units import write_unit

    given = model.estimator, model.state, table, model.support, model.noise_std
    try:
        tables = valve_tables(*given)
    except ValueError as error:
        raise ConfigurationError(f"{out}: {error}") from None
    binary = write_unit(out, tables, title)
    if binary is None:
        write_line("without a binary: there is no C compiler here; import it as a source FMU")
    else:
        write_line(f"with a binary for {binary} and its source")


def _configured(config: Path | None) -> "Config | None":
    if config is None:
        return None
    from valvemap.config.loading import load_config

    return load_config(config)


def _numbers(option: str, text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise typer.BadParameter(
            f"{option} {text}: numbers with commas between are wanted"
        ) from None


def _grid(Q: list[float], dp: list[float]) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.meshgrid(np.array(Q), np.array(dp), indexing="ij")
    return rows.ravel(), columns.ravel()


def _table(title: str, Q: np.ndarray, dp: np.ndarray, T: np.ndarray, answer: "Inversion") -> Table:
    table = Table(title=title, title_justify="left")
    for heading in ("Q, l/min", "dp, bar", "T, °C", "U, %", "from", "to"):
        table.add_column(heading, justify="right")
    table.add_column("status")
    rows = zip(Q, dp, T, answer.U, answer.lower, answer.upper, answer.status, strict=True)
    for number, (*numbers, status) in enumerate(rows):
        if number == MOST_ROWS:
            table.add_row(*["…"] * 6, f"{len(Q) - MOST_ROWS} more; see --to")
            break
        shown = ("–" if np.isnan(x) else f"{x:.2f}" for x in numbers)
        table.add_row(*shown, InverseStatus(status).name)
    return table
