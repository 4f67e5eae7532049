"""The page of the command line, generated from its commands."""

import re

import typer
from typer.cli import get_docs_for_click

from valvemap.cli.command_table import COMMANDS, load_command

_OPTION = re.compile(r"^(\* `[^`]+`)(.*)$", re.MULTILINE)
_HEAD = """# Commands

Exit code 0; 1 if it could not be done, 2 if it was asked wrongly. A mistake is one line that names
thing, place and remedy. `valvemap COMMAND --help` says the same; `valvemap --version` prints the
version.
"""


def commands_page() -> str:
    """Return the page with all commands, their arguments and options."""
    parts = [_HEAD]
    for name in COMMANDS:
        command = load_command(name)
        context = typer.Context(command, info_name=name)
        text = get_docs_for_click(obj=command, ctx=context, indent=1, call_prefix="valvemap")
        parts.append(_OPTION.sub(_without_markup, text))
    return "\n".join(part.strip() + "\n" for part in parts)


def _without_markup(option: re.Match[str]) -> str:
    """Escape angle brackets in the text of an option."""
    return option[1] + option[2].replace("<", "&lt;")
