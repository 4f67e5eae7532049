"""Options that several commands share."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from valvemap.config.models import Config

ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config",
        "-c",
        metavar="FILE",
        help="Configuration (TOML); VALVEMAP_<SECTION>__<FIELD> in the environment overrides it.",
    ),
]
FolderOption = Annotated[
    Path,
    typer.Option(
        envvar="VALVEMAP_DATA", metavar="FOLDER", help="Where certificates, users and states live."
    ),
]
RevocationOption = Annotated[
    bool,
    typer.Option(
        envvar="VALVEMAP_SECURITY__REQUIRE_CRL",
        help="Certificates of an authority need its revocation list.",
    ),
]


SourceOption = Annotated[
    str | None, typer.Option(metavar="NAME", help="Which of [[sources]], where there are several.")
]


def of_source(config: "Config", source: str | None) -> "Config":
    """The part of a configuration that one source has.

    Raises
    ------
    BadParameter
        naming the sources there are.
    """
    names = [named.name for named in config.sources]
    there = f"there are {', '.join(names)}" if names else "there is [source] alone"
    if source is not None and source not in names:
        raise typer.BadParameter(f"--source {source}: no such source; {there}")
    if source is None and names:
        raise typer.BadParameter(f"--source NAME is needed: {there}")
    return config if source is None else config.only(source)


def check_folder(option: str, file: Path | None) -> None:
    """Refuse a file to write whose folder is not there, before any work is done.

    Raises
    ------
    BadParameter
        naming option, file and folder.
    """
    if file is not None and not file.parent.is_dir():
        raise typer.BadParameter(f"{option} {file}: there is no folder {file.parent}; make it")
