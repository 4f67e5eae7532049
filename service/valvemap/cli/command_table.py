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
    "rig": Entry("rig", "Run the virtual test rig, an OPC UA server, until Ctrl-C."),
    "serve": Entry(
        "serve",
        "Subscribe to the source, identify, publish, until Ctrl-C; SIGHUP reads the configuration.",
    ),
    "dashboard": Entry("dashboard", "Serve the live page, until Ctrl-C."),
    "mqtt": Entry(
        "mqtt", "Send results to the MQTT broker of [mqtt] as Sparkplug B, until Ctrl-C."
    ),
    "replay": Entry("replay", "Identify valves from recordings, as the live service does."),
    "axis": Entry(
        "axis",
        "Identify four edges, bulk modulus and leakage from a cylinder's position and pressures.",
    ),
    "invert": Entry(
        "invert",
        "Compute the control voltage for a flow at a pressure drop, with its 95 % interval.",
    ),
    "export": Entry(
        "invert",
        "Export the map for a PLC, a program or a simulator: a lookup table with a stated error.",
    ),
    "report": Entry(
        "report", "Rebuild the paper's figures and tables, and judge its claims (in a clone)."
    ),
    "record": Entry("serve", "Record the source's samples to a file."),
    "check-config": Entry("serve", "Check a configuration file and print its effect."),
    "connect": Entry(
        "connect", "Find the valves of a server, check their signals, write a configuration."
    ),
    "commission": Entry(
        "commission", "Drive a valve through its range until its map is known, within limits."
    ),
    "sheet": Entry(
        "sheet",
        "Print a valve's sheet: rated flow, dead band, hysteresis and more, with intervals.",
    ),
    "dynamics": Entry(
        "dynamics",
        "Print a valve's dynamics: natural frequency, damping, slew, dead time, meter lag, T90.",
    ),
    "init": Entry("security", "Create certificates, users and a configuration."),
    "trust": Entry(
        "security", "Trust a certificate of an application or user, or list the rejected ones."
    ),
    "baseline": Entry(
        "baseline",
        "Approve a valve's map as reference, compare with it, restore it.",
    ),
    "history": Entry("history", "Past signals, as kept by the service."),
    "state": Entry(
        "state", "List, adopt, rename, export and import learnt states of valves and axes."
    ),
    "fleet": Entry("fleet", "Identify the valves of many machines, through Kafka."),
    "schema": Entry(
        "package",
        "Print the JSON schema of the configuration, for editors that complete and check TOML.",
    ),
    "unit": Entry("package", "Print a systemd unit that serves a configuration from boot on."),
    "warm-up": Entry("serve", "Compile the estimators ahead (for images)."),
}
"""All commands; `--help` and shell completion read this table without importing any module."""


SERVING: Final = (
    *(("rig",), ("serve",), ("dashboard",), ("mqtt",)),
    *(("fleet", "collect"), ("fleet", "work"), ("fleet", "serve")),
)
"""Commands that serve until they are stopped: SIGTERM while they start is no failure."""
IDENTIFYING: Final = (("serve",), ("fleet", "work"))
"""Commands that are refused where the address space is too small for kernels and threads."""


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
