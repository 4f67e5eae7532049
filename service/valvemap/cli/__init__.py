"""The command ``valvemap``: exit code 0, 1 (the command failed) or 2 (usage error)."""

import errno
import gc
import io
import logging
import os
import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.main import get_command

from valvemap.cli.command_table import COMMANDS, IDENTIFYING, SERVING, LazyGroup
from valvemap.errors import ValvemapError
from valvemap.foreign_text import LINE, printable, printable_lines
from valvemap.numba_version import ask_for_shortcuts

__all__ = ["COMMANDS", "application", "main", "run"]

_QUIET = ("asyncua", "numba", "matplotlib")  # libraries whose warnings concern no user

_ENDED = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EPIPE}  # of a nameless output

_UsageError: Any = typer.BadParameter.__base__  # typer exports its children only


def main() -> None:
    """Run the command line; errors of the user are one line without a traceback."""
    if any(tuple(sys.argv[1 : 1 + len(words)]) == words for words in SERVING):
        signal.signal(signal.SIGTERM, _end)  # the command replaces it, once it can be stopped
    ask_for_shortcuts()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: more threads only spin
    gc.set_threshold(50_000, 20, 20)  # imports and address spaces create little garbage
    for name in _QUIET:
        logging.getLogger(name).setLevel(logging.ERROR)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # ASCII and code pages have no √ and °
    code = run(sys.argv[1:])
    gc.freeze()  # skip the collection at exit
    sys.exit(code)


def _end(_number: int, _frame: object) -> None:
    """End a service that has not begun: nothing is to be saved."""
    raise SystemExit(0)


def run(arguments: list[str]) -> int:
    """Run one command; return its exit code."""
    try:
        if any(tuple(arguments[: len(words)]) == words for words in IDENTIFYING):
            from valvemap.app.limits import allow_address_space

            allow_address_space()
        code = get_command(application()).main(arguments, standalone_mode=False)
        _flush()
    except typer.Exit as end:
        return int(end.exit_code)
    except _UsageError as error:
        asked_nothing = type(error).__name__ == "NoArgsIsHelpError"
        said = error.format_message()
        return _say(said if asked_nothing else f"valvemap: {printable(said, LINE)}", 2)
    except (KeyboardInterrupt, typer.Abort):
        return _say("valvemap: interrupted", 1)
    except OSError as error:
        return _ended_output(error)
    except Exception as error:
        if not _is_for_the_user(error):
            raise
        return _say(f"valvemap: {error}", _exit_code(error))
    return int(code or 0)


def _flush() -> None:
    if sys.stdout is not None:  # it is closed
        sys.stdout.flush()


def _ended_output(error: OSError) -> int:
    """Say that standard output takes no more; any other error is raised."""
    if _is_for_the_user(error):
        return _say(f"valvemap: {error}", _exit_code(error))
    if error.filename is not None or error.errno not in _ENDED:
        raise error
    with Path(os.devnull).open("wb") as nothing:  # the interpreter flushes again at its exit
        os.dup2(nothing.fileno(), sys.stdout.fileno())
    if error.errno == errno.EPIPE:
        return 1
    return _say(f"valvemap: standard output: {str(error.strerror).lower()}", 1)


def application() -> typer.Typer:
    """The command line; a command's module is imported when the command runs."""
    app = typer.Typer(
        cls=LazyGroup,
        name="valvemap",
        help="Identify hydraulic valves' flow maps online, over OPC UA.",
        no_args_is_help=True,
        add_completion=True,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
    )
    app.callback()(_options)
    return app


def _print_version(asked: bool) -> None:  # noqa: FBT001 - a callback of Typer
    if asked:
        from importlib.metadata import version

        typer.echo(f"valvemap {version('valvemap')}")
        raise typer.Exit


def _options(
    *,
    version: Annotated[
        bool,
        typer.Option(
            "--version", is_eager=True, callback=_print_version, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Options of `valvemap` itself."""


def _is_for_the_user(error: Exception) -> bool:
    if isinstance(error, ValvemapError):
        return True
    from guarded_opcua import HardenedError
    from valvemap_rig.scenario import ScenarioError

    return isinstance(error, HardenedError | ScenarioError)


def _exit_code(error: Exception) -> int:
    """Return 2 for usage errors, else 1."""
    if isinstance(error, ValvemapError):
        return error.exit_code
    from guarded_opcua import ConfigurationError, HardenedError

    return 2 if isinstance(error, ConfigurationError) or not isinstance(error, HardenedError) else 1


def _say(line: str, code: int) -> int:
    print(printable_lines(line), file=sys.stderr)  # noqa: T201 - why a command failed
    return code
