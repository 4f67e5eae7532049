"""Histories: a server's history as a recording for replay; the service's history as ``history``."""

import asyncio
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvemap.cli.options import ConfigOption, ForceOption, new_file
from valvemap.cli.output import write_line
from valvemap.cli.progress import working
from valvemap.config.loading import load_config
from valvemap.errors import RecordingError

if TYPE_CHECKING:
    from valvemap.config.models import Config

_SERVER = "opc.tcp://"

history = typer.Typer(help="Past signals, as kept by the service.", no_args_is_help=True)


@history.callback()
def _of_the_service() -> None:
    """One command alone keeps its name, too."""


@history.command()
def export(
    file: Annotated[
        Path, typer.Argument(help="FILE.csv, .csv.gz, .csv.xz or .parquet", callback=new_file)
    ],
    config: ConfigOption = None,
    valve: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="One valve, or several; none = all.")
    ] = None,
    since: Annotated[
        str | None, typer.Option("--from", metavar="T", help="First time, ISO 8601 or UTC ns.")
    ] = None,
    until: Annotated[
        str | None, typer.Option("--to", metavar="T", help="Last time; none = now.")
    ] = None,
    *,
    force: ForceOption = False,
) -> None:
    """Export the service's history of signals as a recording."""
    from valvemap.app.history import export_history

    loaded = load_config(config)
    start = 0 if since is None else _time("--from", since)
    stop = time.time_ns() if until is None else _time("--to", until)
    if stop < start:
        raise typer.BadParameter(f"--to {until}: is before --from {since}")
    with working(f"reading {loaded.history.file}") as say:
        n = export_history(
            loaded, file, valve or [], start, stop, lambda n: say(f"{file.name}: {n:,} samples")
        )
    write_line(f"{file}: {n:,} samples")


@contextmanager
def recordings_of(
    files: Sequence[str], config: Path | None, since: str | None, until: str | None
) -> Iterator[list[Path]]:
    """Yield the recordings; or a temporary recording of a server's history.

    Raises
    ------
    BadParameter
        naming the option.
    """
    servers = [file for file in files if file.startswith(_SERVER)]
    if not servers:
        given = "--from" if since is not None else "--to"
        if since is not None or until is not None:
            raise typer.BadParameter(f"{given}: only with the {_SERVER}… of a server")
        yield [Path(file) for file in files]
        return
    if len(files) > 1:
        raise typer.BadParameter(f"{servers[0]}: one server alone, and no recordings beside it")
    if since is None:
        raise typer.BadParameter(f"{servers[0]}: --from T says from when on, e.g. 2026-12-31T08:00")
    start = _time("--from", since)
    stop = time.time_ns() if until is None else _time("--to", until)
    if stop < start:
        raise typer.BadParameter(f"--to {until}: is before --from {since}")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "history.csv"
        _fetch(_config_at(servers[0], load_config(config)), file, start, stop)
        yield [file]


def _fetch(config: "Config", file: Path, start: int, stop: int) -> None:
    from valvemap.app.record import record_history

    with working(f"reading the history of {config.source.url}") as say:
        found = asyncio.run(
            record_history(config, file, start, stop, lambda n: say(f"history: {n:,} samples"))
        )
    if not found:
        raise RecordingError(
            f"{config.source.url}: its history has no samples between --from and --to; ask for "
            "another span, or look whether these signals are historized"
        )


def _config_at(url: str, config: "Config") -> "Config":
    """Return the configuration of the source at ``url``; of several sources, the matching one."""
    if not config.sources:
        return config.model_copy(update={"source": config.source.model_copy(update={"url": url})})
    for source in config.sources:
        if source.url == url:
            return config.only(source.name)
    there = ", ".join(source.url for source in config.sources)
    raise typer.BadParameter(f"{url}: is none of the configured sources; there are {there}")


def _time(option: str, text: str) -> int:
    from valvemap.storage.columns import ALLOWED_TIME, CellError, times

    try:
        return int(times([text])[0])
    except CellError:
        raise typer.BadParameter(f"{option} {text}: allowed is {ALLOWED_TIME}") from None
