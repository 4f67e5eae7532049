"""``valvemap axis``: a cylinder as the flow meter of its valve."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.table import Table

from valvemap.cli.options import ForceOption, new_file
from valvemap.cli.output import terminal, write_line
from valvemap.cli.progress import working
from valvemap.errors import ConfigurationError, RecordingError

if TYPE_CHECKING:
    from valvemap.model.axis_fit import AxisFit
    from valvemap.model.axis_search import AxisResult

_U_PERCENT: Final = (20, 40, 60, 80, 100)
_RATED_BAR: Final = 70.0


def axis(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="Recording: t, U, x (or v), pA, pB, pS, pT; T, valve."),
    ],
    piston: Annotated[float, typer.Option(min=1.0, metavar="MM", help="Diameter of the piston.")],
    rod: Annotated[float, typer.Option(min=0.0, metavar="MM", help="Diameter of the rod.")],
    stroke: Annotated[float, typer.Option(min=1.0, metavar="MM", help="Between the end stops.")],
    dead: Annotated[
        float,
        typer.Option(
            min=0.01, metavar="L", help="Volume of line A retracted: hose and chamber, in l."
        ),
    ],
    dead_b: Annotated[
        float | None,
        typer.Option(min=0.01, metavar="L", help="The same of line B extended.  [default: as A]"),
    ] = None,
    name: Annotated[
        str | None, typer.Option("--axis", metavar="NAME", help="Axis, if there are several.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--to",
            metavar="FILE.st",
            help="Write the inverse for speed as a function block.",
            callback=new_file,
        ),
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="OUT", help="Write the result as JSON.", callback=new_file),
    ] = None,
    version: Annotated[
        int, typer.Option(min=1, metavar="N", help="Version number of the function block.")
    ] = 1,
    *,
    force: ForceOption = False,
) -> None:
    """Identify four edges, bulk modulus and leakage from a cylinder's position and pressures."""
    from valvemap.model.axis import AxisGeometry
    from valvemap.model.axis_inverse import axis_table
    from valvemap.model.axis_search import identify
    from valvemap.owned_files import write_whole
    from valvemap.storage.axis_recordings import read_axes
    from valvemap.storage.axis_tables import write_axis_table

    if rod >= piston:
        raise ConfigurationError(f"--rod {rod:g} mm must be less than --piston {piston:g} mm")
    axes = read_axes(file)
    if name is None and len(axes) > 1:
        raise ConfigurationError(f"{file} has the axes {', '.join(axes)}: name one with --axis")
    chosen = name or next(iter(axes))
    if chosen not in axes:
        raise ConfigurationError(f"{file} has no axis {chosen}; allowed are {', '.join(axes)}")
    geometry = AxisGeometry(piston, rod, stroke, dead, dead if dead_b is None else dead_b)
    with working(f"{file.name}: searching play and spool"):
        result = identify(axes[chosen], geometry)
    if json_file is not None:
        write_whole(json_file, json.dumps({chosen: _as_json(result)}, indent=1) + "\n")
    if result.status or result.fit is None:
        raise RecordingError(f"{file}, {chosen}: {result.sentence}")
    _show(chosen, result.fit, result.left_out)
    if out is not None:
        title = f"{chosen}, from {file.name}"
        write_axis_table(out, axis_table(result.fit), title, version)
        write_line(f"{out}: function block FB_AxisRequiredU, version {version}")


def _show(name: str, found: "AxisFit", left_out: dict[str, int]) -> None:
    from valvemap.vocabulary.edges import EDGES

    table = Table(title=f"{name}: flow in l/min at {_RATED_BAR:g} bar over the edge")
    for heading in ("U, %", *EDGES):
        table.add_column(heading, justify="right")
    for U in _U_PERCENT:
        cells = [
            f"{float(found.flow(edge, U, _RATED_BAR)):.1f} ± "
            f"{1.96 * float(found.flow_std(edge, U, _RATED_BAR)):.1f}"
            for edge in EDGES
        ]
        table.add_row(str(U), *cells)
    terminal().print(table)
    regression = found.regression
    beta, leakage = found.bulk_modulus, found.leakage
    write_line(f"bulk modulus {beta[0]:.3f} ± {1.96 * beta[1]:.3f} GPa")
    write_line(f"leakage between A and B {leakage[0]:.4f} ± {1.96 * leakage[1]:.4f} l/min/bar")
    write_line(f"play {regression.play_percent:.1f} %, spool {regression.spool_hz:.0f} Hz")
    left = ", ".join(f"{reason} {n}" for reason, n in left_out.items() if n and reason != "used")
    write_line(f"intervals used {left_out['used']:,}; left out: {left or 'none'}")
    write_line("A wrong piston area scales these flows; the speeds they predict stay right.")


def _as_json(result: "AxisResult") -> dict[str, Any]:
    """Return what --json writes of an axis."""
    from valvemap.model.axis_inverse import axis_table
    from valvemap.vocabulary.edges import EDGES

    told: dict[str, Any] = {
        "status": result.status.name,
        "sentence": result.sentence,
        "left_out": result.left_out,
    }
    if result.status or result.fit is None:
        return told
    found, table = result.fit, axis_table(result.fit)
    edges = {
        edge: {
            "U": table.y.tolist(),
            "K": table.K[k].tolist(),
            "K_std": table.spread[k].tolist(),
            "departure": table.departure[k].tolist(),
            "known_to_U": float(table.known[k]),
        }
        for k, edge in enumerate(EDGES)
    }
    pairs = {
        "bulk_modulus_GPa": found.bulk_modulus,
        "leakage_l_min_bar": found.leakage,
        "air_percent": found.air,
    }
    return {
        **told,
        "edges": edges,
        **{key: {"value": value, "std": std} for key, (value, std) in pairs.items()},
        "play_percent": found.regression.play_percent,
        "spool_hz": found.regression.spool_hz,
    }
