"""Options shared by several commands."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvemap.errors import ConfigurationError

if TYPE_CHECKING:
    from valvemap.app.metrics_address import MetricsAddress
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
        envvar="VALVEMAP_DATA", metavar="FOLDER", help="Folder of certificates, users and states."
    ),
]
RevocationOption = Annotated[
    bool,
    typer.Option(
        envvar="VALVEMAP_SECURITY__REQUIRE_CRL",
        help="Certificates of an authority need its revocation list.",
    ),
]


RatedFlowOption = Annotated[
    float, typer.Option(min=0.0, metavar="L_MIN", help="Of the name plate, to check Q.")
]
RatedDropOption = Annotated[
    float, typer.Option(min=0.1, metavar="BAR", help="Pressure drop of the rated flow.")
]
MetricsOption = Annotated[
    str | None,
    typer.Option(
        envvar="VALVEMAP_METRICS",
        metavar="ADDRESS:PORT",
        help="Serve metrics for Prometheus there, e.g. 127.0.0.1:9464; default: nowhere.",
    ),
]
MetricsHostOption = Annotated[
    list[str] | None,
    typer.Option(
        "--metrics-host-name",
        envvar="VALVEMAP_METRICS_HOSTS",
        help="Name under which Prometheus reaches it, if not this host.",
    ),
]
SourceOption = Annotated[
    str | None, typer.Option(metavar="NAME", help="Which of [[sources]], where there are several.")
]

InsistOption = Annotated[
    bool, typer.Option("--insist", help="Learn even from implausible signals.")
]
ForceOption = Annotated[
    bool,
    typer.Option(
        "--force",
        is_eager=True,  # outputs are checked first
        help="Replace existing files.",
    ),
]


def new_file(
    context: typer.Context, option: typer.CallbackParam, value: Path | None
) -> Path | None:
    """Check an output file: its folder exists; the file does not, unless ``--force`` is set."""
    return _new(context, option, value, lambda file: [file])


def new_recording(
    context: typer.Context, option: typer.CallbackParam, value: Path | None
) -> Path | None:
    """Check a recording to write, and its companion files."""
    beside = lambda file: [file, file.with_name(f"{file.name}.timing.json")]  # noqa: E731
    return _new(context, option, value, beside)


def new_models(
    context: typer.Context, option: typer.CallbackParam, value: Path | None
) -> Path | None:
    """Check a model to write (FILE.json), or a folder of models ``<Valve>.<Estimator>.json``."""
    if value is None or value.suffix == ".json":
        return new_file(context, option, value)
    return _new(context, option, value, lambda folder: folder.glob("?*.?*.json"), folder=True)


def new_pages(
    context: typer.Context, option: typer.CallbackParam, value: Path | None
) -> Path | None:
    """Check a folder of pages and pictures to write."""
    kinds = "*.html", "*.png", "paper.json"
    found = lambda folder: [file for kind in kinds for file in folder.glob(kind)]  # noqa: E731
    return _new(context, option, value, found, folder=True)


def _new(
    context: typer.Context,
    option: typer.CallbackParam,
    value: Path | None,
    written: Callable[[Path], Iterable[Path]],
    *,
    folder: bool = False,
) -> Path | None:
    """Refuse to replace a file before any work is done.

    Raises
    ------
    ConfigurationError
        naming option and file.
    """
    if value is None or context.resilient_parsing:
        return value
    name = option.opts[0] if option.opts[0].startswith("-") else option.opts[0].upper()
    if not folder:
        check_folder(name, value)
        if value.is_dir():
            raise ConfigurationError(f"{name} {value}: is a folder; name a file")
    there = [file for file in written(value) if file.is_file()]
    if there and not context.params.get("force"):
        raise ConfigurationError(
            f"{name} {there[0]}: is there already; another name, or --force, is needed"
        )
    return value


def of_source(config: "Config", source: str | None) -> "Config":
    """Return the part of a configuration that belongs to one source.

    Raises
    ------
    BadParameter
        naming the available sources.
    """
    names = [named.name for named in config.sources]
    there = f"there are {', '.join(names)}" if names else "there is [source] alone"
    if source is not None and source not in names:
        raise typer.BadParameter(f"--source {source}: no such source; {there}")
    if source is None and names:
        raise typer.BadParameter(f"--source NAME is needed: {there}")
    return config if source is None else config.only(source)


def check_folder(option: str, file: Path | None) -> None:
    """Refuse an output file without a folder before any work is done.

    Raises
    ------
    BadParameter
        naming option, file and folder.
    """
    if file is not None and not file.parent.is_dir():
        raise typer.BadParameter(f"{option} {file}: there is no folder {file.parent}; make it")


def address_and_port(listen: str) -> tuple[str, int]:
    """Split ADDRESS:PORT.

    Raises
    ------
    BadParameter

    Examples
    --------
    >>> address_and_port("[::1]:8080")
    ('::1', 8080)
    """
    host, _, port = listen.rpartition(":")
    if not host or not (port.isascii() and port.isdigit()) or int(port) > 65_535:
        raise typer.BadParameter(f"{listen!r}: ADDRESS:PORT is expected, e.g. 127.0.0.1:8080")
    return host.strip("[]"), int(port)


def metrics_address(listen: str | None, host_names: list[str] | None) -> "MetricsAddress | None":
    """Return where to serve metrics; None if they are not asked for.

    Raises
    ------
    BadParameter
    """
    from valvemap.app.metrics_address import MetricsAddress

    if listen is None:
        return None
    return MetricsAddress(*address_and_port(listen), tuple(host_names or ()))
