"""The command ``valvemap``: exit code 0, 1 (it could not be done) or 2 (it was asked wrongly)."""

import sys
from typing import Any

import typer

from service.cli import demo, invert, replay, report, rig, security, serve
from service.errors import ValvemapError
from virtual_rig.scenario import ScenarioError

_UsageError: Any = typer.BadParameter.__base__  # typer exports its children only

app = typer.Typer(
    name="valvemap",
    help="Identify hydraulic valves' flow maps online, over OPC UA.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.command()(demo.demo)
app.command()(rig.rig)
app.command()(serve.serve)
app.command()(replay.replay)
app.command()(invert.invert)
app.command()(invert.export)
app.command()(report.report)
app.command()(serve.record)
app.command()(serve.check_config)
app.command()(security.init)
app.command()(security.trust)
app.command()(serve.warm_up)


def main() -> None:
    """Run the command line; a user's mistake is one line, never a traceback."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run one command; return its exit code."""
    try:
        code = app(arguments, standalone_mode=False)
    except typer.Exit as end:
        return int(end.exit_code)
    except _UsageError as error:
        asked_nothing = type(error).__name__ == "NoArgsIsHelpError"
        return _say(f"{'' if asked_nothing else 'valvemap: '}{error.format_message()}", 2)
    except (KeyboardInterrupt, typer.Abort):
        return _say("valvemap: interrupted", 1)
    except (ScenarioError, ValvemapError) as error:
        return _say(f"valvemap: {error}", getattr(error, "exit_code", 2))
    return int(code or 0)


def _say(line: str, code: int) -> int:
    print(line, file=sys.stderr)  # noqa: T201 - the last word of a command that failed
    return code
