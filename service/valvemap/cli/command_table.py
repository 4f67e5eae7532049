"""The commands: name, module and help line of each; a module is imported when its command runs."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any, Final, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

_STYLE: Final[Mapping[str, Any]] = {"rich_markup_mode": None, "pretty_exceptions_enable": False}


class Entry(NamedTuple):
    """Module of a command, and the first line of its docstring."""

    module: str
    help: str


COMMANDS: Final[Mapping[str, Entry]] = {
    "demo": Entry("demo", "Run rig and service, until Ctrl-C."),
    "rig": Entry("rig", "Run the virtual test rig as an OPC UA server, until Ctrl-C."),
    "serve": Entry(
        "serve",
        "Subscribe to the source, identify, publish, until Ctrl-C; SIGHUP reads the configuration.",
    ),
    "dashboard": Entry("dashboard", "Serve the live page, until Ctrl-C."),
    "mqtt": Entry(
        "mqtt", "Send results to an MQTT broker as Sparkplug B, until Ctrl-C; [mqtt] says where."
    ),
    "replay": Entry("replay", "Identify from recordings, as live."),
    "invert": Entry(
        "invert",
        "Which control voltage passes a flow at a pressure drop, with its 95 % interval.",
    ),
    "export": Entry(
        "invert",
        "Export the map for a PLC, a program or a simulator: a lookup table with a stated error.",
    ),
    "report": Entry(
        "report", "Rebuild the paper's figures and tables, and judge its claims (in a clone)."
    ),
    "record": Entry("serve", "Record the source's samples to a file."),
    "check-config": Entry("serve", "Check a configuration file and say what it would do."),
    "connect": Entry(
        "connect", "Find the valves of a server, watch their signals, write a configuration."
    ),
    "init": Entry("security", "Make certificates, users and configuration."),
    "trust": Entry(
        "security", "Trust a certificate, of an application or of a user, or list the rejected."
    ),
    "baseline": Entry(
        "baseline",
        "Approve a valve's map as that of the new valve, compare with it, go back to it.",
    ),
    "history": Entry("history", "What signals have been."),
    "fleet": Entry("fleet", "Many machines, by way of Kafka."),
    "schema": Entry(
        "package",
        "Print the JSON schema of the configuration, for editors that complete and check TOML.",
    ),
    "unit": Entry("package", "Print a systemd unit that serves a configuration from boot on."),
    "warm-up": Entry("serve", "Compile the estimators ahead (for images)."),
}
"""All commands; `--help` and shell completion read this table without importing any module."""


class LazyGroup(TyperGroup):
    """The commands of the table, each imported when the command line names it."""

    def __init__(self, **attributes: Any) -> None:  # noqa: ANN401 - Typer's own
        super().__init__(**attributes)
        self.commands = {
            name: TyperCommand(name, help=entry.help, rich_markup_mode=None)
            for name, entry in COMMANDS.items()
        }

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[Any, Any, list[str]]:  # noqa: ANN401 - Typer's own
        """Import the command that the arguments name."""
        name, found, rest = super().resolve_command(ctx, args)
        return name, None if found is None else load_command(str(name)), rest


def load_command(name: str) -> Any:  # noqa: ANN401 - Typer exports no class of commands
    """Import one command of the table."""
    module = import_module(f"valvemap.cli.{COMMANDS[name].module}")
    command = getattr(module, name.replace("-", "_"))
    app = typer.Typer(**_STYLE)
    app.callback()(lambda: None)  # otherwise Typer drops the name of a single command
    if isinstance(command, typer.Typer):
        app.add_typer(command, name=name)
    else:
        app.command(name)(command)
    group: Any = get_command(app)
    return group.commands[name]
