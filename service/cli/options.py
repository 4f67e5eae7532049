"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

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


def check_folder(option: str, file: Path | None) -> None:
    """Refuse a file to write whose folder is not there, before any work is done.

    Raises
    ------
    BadParameter
        naming option, file and folder.
    """
    if file is not None and not file.parent.is_dir():
        raise typer.BadParameter(f"{option} {file}: there is no folder {file.parent}; make it")
