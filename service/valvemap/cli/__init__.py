"""The command ``valvemap``: exit code 0, 1 (it could not be done) or 2 (it was asked wrongly)."""

import gc
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, Final

import typer

from valvemap.errors import ValvemapError
from valvemap.numba_version import ask_for_shortcuts

COMMANDS: Final[Mapping[str, str]] = {
    "demo": "demo",
    "rig": "rig",
    "serve": "serve",
    "dashboard": "dashboard",
    "mqtt": "mqtt",
    "replay": "replay",
    "invert": "invert",
    "export": "invert",
    "report": "report",
    "record": "serve",
    "check-config": "serve",
    "connect": "connect",
    "init": "security",
    "trust": "security",
    "baseline": "baseline",
    "history": "history",
    "fleet": "fleet",
    "schema": "package",
    "unit": "package",
    "warm-up": "serve",
}
"""Each command and the module that holds it: what others need is not imported, so `serve` starts
in half the time."""

_UsageError: Any = typer.BadParameter.__base__  # typer exports its children only


def main() -> None:
    """Run the command line; a user's mistake is one line, never a traceback."""
    ask_for_shortcuts()
    gc.set_threshold(50_000, 20, 20)  # what imports and address spaces make is no garbage
    code = run(sys.argv[1:])
    gc.freeze()  # else all of it is looked through once more at the end
    sys.exit(code)


def run(arguments: list[str]) -> int:
    """Run one command; return its exit code."""
    try:
        code = application(arguments[:1])(arguments, standalone_mode=False)
    except typer.Exit as end:
        return int(end.exit_code)
    except _UsageError as error:
        asked_nothing = type(error).__name__ == "NoArgsIsHelpError"
        return _say(f"{'' if asked_nothing else 'valvemap: '}{error.format_message()}", 2)
    except (KeyboardInterrupt, typer.Abort):
        return _say("valvemap: interrupted", 1)
    except Exception as error:
        if not _is_for_the_user(error):
            raise
        return _say(f"valvemap: {error}", _exit_code(error))
    return int(code or 0)


def application(asked: Sequence[str] = ()) -> typer.Typer:
    """The command line with the commands ``asked`` for, with all if one of them is unknown."""
    app = typer.Typer(
        name="valvemap",
        help="Identify hydraulic valves' flow maps online, over OPC UA.",
        no_args_is_help=True,
        add_completion=True,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
    )
    app.callback()(lambda: None)  # one command alone keeps its name, too
    for name in asked if asked and COMMANDS.keys() >= set(asked) else COMMANDS:
        module = import_module(f"{__name__}.{COMMANDS[name]}")
        command = getattr(module, name.replace("-", "_"))
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            app.command(name)(command)
    return app


def _is_for_the_user(error: Exception) -> bool:
    if isinstance(error, ValvemapError):
        return True
    from guarded_opcua import HardenedError
    from valvemap_rig.scenario import ScenarioError

    return isinstance(error, HardenedError | ScenarioError)


def _exit_code(error: Exception) -> int:
    """2 where the user asked wrongly, 1 where it could not be done."""
    if isinstance(error, ValvemapError):
        return error.exit_code
    from guarded_opcua import ConfigurationError, HardenedError

    return 2 if isinstance(error, ConfigurationError) or not isinstance(error, HardenedError) else 1


def _say(line: str, code: int) -> int:
    print(line, file=sys.stderr)  # noqa: T201 - the last word of a command that failed
    return code
