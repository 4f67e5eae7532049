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
