"""Terminal output: the only module that writes to the terminal; unprintable text is escaped."""

from typing import Any

import typer
from rich.console import Console
from rich.progress import ProgressColumn, Task
from rich.text import Text

from valvemap.foreign_text import printable, printable_lines


def write_line(text: str) -> None:
    """Print one or more lines of trusted text."""
    typer.echo(printable_lines(text))


def terminal(*, error: bool = False) -> Console:
    """Return a console for tables, without markup."""
    return _Plain(stderr=error, markup=False, emoji=False)


class Description(ProgressColumn):
    """Description of a progress bar."""

    def render(self, task: Task) -> Text:
        """Render the description in one line."""
        return Text(printable(task.description))


class _Plain(Console):
    def render_str(self, text: str, **how: Any) -> Text:  # noqa: ANN401 - rich's options
        """Render text without markup."""
        return super().render_str(printable_lines(text), **{**how, "markup": False, "emoji": False})
