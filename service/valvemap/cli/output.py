"""Output of commands: the only module that writes to the terminal; every text is printable."""

from typing import Any

import typer
from rich.console import Console
from rich.progress import ProgressColumn, Task
from rich.text import Text

from valvemap.foreign_text import printable, printable_lines


def write_line(text: str) -> None:
    """Print a line, or lines of our own making."""
    typer.echo(printable_lines(text))


def terminal(*, error: bool = False) -> Console:
    """Return a console for tables: names are shown as they are, no markup is obeyed."""
    return _Plain(stderr=error, markup=False, emoji=False)


class Description(ProgressColumn):
    """The text of a bar."""

    def render(self, task: Task) -> Text:
        """Show it in one line."""
        return Text(printable(task.description))


class _Plain(Console):
    def render_str(self, text: str, **how: Any) -> Text:  # noqa: ANN401 - rich's options
        """Show a text without obeying it."""
        return super().render_str(printable_lines(text), **{**how, "markup": False, "emoji": False})
