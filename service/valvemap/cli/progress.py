"""Progress bars on the error stream, if it is a terminal."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TaskProgressColumn,
    TimeElapsedColumn,
)

from valvemap.cli.output import Description, terminal


@contextmanager
def bars() -> Iterator[Progress]:
    """Yield a display of progress bars; ``add_task`` adds one."""
    console = terminal(error=True)
    with Progress(
        Description(),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        console=console,
        disable=not console.is_terminal,
    ) as progress:
        yield progress


@contextmanager
def working(what: str) -> Iterator[Callable[[str], None]]:
    """Show a spinner; yields a function that changes its text."""
    console = terminal(error=True)
    columns = SpinnerColumn(), Description(), TimeElapsedColumn()
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as progress:
        task = progress.add_task(what, total=None)

        def say(text: str) -> None:
            progress.update(task, description=text)

        yield say


def of_files(progress: Progress) -> Callable[[Path, float], None]:
    """Return a callback that shows a bar for each file read."""
    tasks = {}

    def update(file: Path, fraction: float) -> None:
        if file not in tasks:
            tasks[file] = progress.add_task(file.name, total=1.0)
        progress.update(tasks[file], completed=fraction)

    return update
