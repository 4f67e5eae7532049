"""``valvemap state``: the learnt states in the state file."""

from pathlib import Path
from typing import Annotated

import typer

from valvemap.cli.options import ConfigOption, ForceOption, new_file
from valvemap.cli.output import write_line
from valvemap.config.loading import load_config

state = typer.Typer(
    help="List, adopt, rename, export and import learnt states of valves and axes.",
    no_args_is_help=True,
)

ValveOption = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME", help="One valve or axis, or several; none = all."),
]


@state.command(name="list")
def list_(config: ConfigOption = None) -> None:
    """List the states, the states set aside, and what the next start makes of each."""
    from valvemap.app.states import list_states

    for line in list_states(load_config(config)):
        write_line(line)


@state.command()
def adopt(
    what: Annotated[
        str, typer.Argument(help="A number of the list, VALVE, AXIS or VALVE.ESTIMATOR.")
    ],
    config: ConfigOption = None,
) -> None:
    """Restore a state that was set aside: it fits the present configuration after all."""
    from valvemap.app.states import adopt as adopt_states

    for name in adopt_states(load_config(config), what):
        write_line(f"{name}: adopted")


@state.command()
def rename(
    old: Annotated[str, typer.Argument(help="Present name of the valve or axis.")],
    new: Annotated[str, typer.Argument(help="Its new name.")],
    config: ConfigOption = None,
) -> None:
    """Give the states of a valve or an axis to another name."""
    from valvemap.app.states import rename as rename_states

    for name in rename_states(load_config(config), old, new):
        write_line(f"{name}: renamed")


@state.command()
def export(
    file: Annotated[Path, typer.Argument(help="File to write.", callback=new_file)],
    config: ConfigOption = None,
    valve: ValveOption = None,
    *,
    force: ForceOption = False,
) -> None:
    """Write states to a file, for another service or as a copy."""
    from valvemap.app.states import export_states

    n = export_states(load_config(config), file, valve or [])
    write_line(f"{file}: {n} states")


@state.command(name="import")
def import_(
    file: Annotated[Path, typer.Argument(help="File that `valvemap state export` wrote.")],
    config: ConfigOption = None,
    valve: ValveOption = None,
) -> None:
    """Store the states of an exported file; those in their place are set aside."""
    from valvemap.app.states import import_states

    for name in import_states(load_config(config), file, valve or []):
        write_line(f"{name}: imported")
