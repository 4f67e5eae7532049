"""``valvemap connect``: writes a configuration from a server's address."""

import asyncio
import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvemap.cli import connect_lines
from valvemap.cli.options import FolderOption, RatedDropOption, RatedFlowOption, new_file
from valvemap.cli.output import terminal, write_line
from valvemap.cli.progress import working
from valvemap.cli.security import make_users
from valvemap.errors import ConfigurationError, SourceRejected, StorageError
from valvemap.foreign_text import LINE, printable
from valvemap.owned_files import write_whole

if TYPE_CHECKING:
    from collections.abc import Callable

    from valvemap.app.connect import Found
    from valvemap.opcua_client.source_settings import SourceSettings

_WATCH_S = 30.0


def _or_yes(context: typer.Context, value: bool) -> bool:  # noqa: FBT001 - typer's callback
    """Let ``--yes`` replace files, too; options that are given come before those that are not."""
    return value or bool(context.params.get("yes"))


def connect(
    context: typer.Context,
    url: Annotated[str, typer.Argument(metavar="URL", help="opc.tcp://HOST:PORT/PATH")],
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", help="Configuration (TOML) to write.", callback=new_file
        ),
    ] = Path("valvemap.toml"),
    data: FolderOption = Path("data"),
    user: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="User name, else anonymous; the password is VALVEMAP_SOURCE__PASSWORD.",
        ),
    ] = None,
    security: Annotated[
        str | None,
        typer.Option(
            metavar="POLICY",
            help="Basic256Sha256, Aes256Sha256RsaPss or None.  [default: the best on offer]",
        ),
    ] = None,
    watch: Annotated[
        float, typer.Option(min=1.0, max=3600.0, metavar="S", help="Duration of the watch.")
    ] = _WATCH_S,
    signal: Annotated[
        list[str] | None,
        typer.Option(
            metavar="VALVE.SIGNAL=NODE",
            help="Answer: the node of U, p1, p2, Q, T or dp; of all, for one more valve. With four "
            "ports: of U, pP, pT, pA, pB, QA, QB or T; all edges are learnt.",
        ),
    ] = None,
    scale: Annotated[
        list[str] | None,
        typer.Option(
            metavar="VALVE.SIGNAL=UNIT",
            help="Answer: a unit, or raw numbers and values, such as 0..27648:0..250bar.",
        ),
    ] = None,
    skip: Annotated[
        list[str] | None, typer.Option(metavar="VALVE", help="Leave out a valve that was found.")
    ] = None,
    ports: Annotated[
        list[str] | None,
        typer.Option(metavar="VALVE", help="Learn all edges of a valve with four ports."),
    ] = None,
    rated_pressure: Annotated[
        float, typer.Option(min=0.0, metavar="BAR", help="Of the name plate, to check p1.")
    ] = 0.0,
    rated_flow: RatedFlowOption = 0.0,
    rated_drop: RatedDropOption = 35.0,
    sheet: Annotated[
        Path | None,
        typer.Option(
            "--sheet", metavar="FILE", help="Write the sheet of signals (HTML).", callback=new_file
        ),
    ] = None,
    *,
    force: Annotated[
        bool,
        typer.Option("--force", is_eager=True, callback=_or_yes, help="Replace files that exist."),
    ] = False,
    yes: Annotated[
        bool,
        typer.Option(
            "--yes",
            is_eager=True,
            help="As --force; take units that nothing states as %, bar, l/min, °C, where that is "
            "plausible; write the valves that are decided.",
        ),
    ] = False,
    trust_server: Annotated[
        bool, typer.Option("--trust-server", help="Trust the certificate that the server shows.")
    ] = False,
) -> None:
    """Find the valves of a server, check their signals, write a configuration."""
    from valvemap.app.connect import look_around
    from valvemap.app.connect_answers import Wanted
    from valvemap.app.connect_toml import configuration
    from valvemap.app.sheet import sheet_page
    from valvemap.config.template import configuration_template
    from valvemap.plant.answers import parse_answers
    from valvemap.plant.evidence import Rating

    console = terminal()
    wanted = Wanted(
        parse_answers(signal or (), scale or (), ports=True),
        Rating(rated_pressure, rated_flow, rated_drop),
        frozenset(skip or ()),
        frozenset(ports or ()),
        assume=yes,
    )
    console.print(f"looking around at {url}, then watching for {watch:g} s ...", soft_wrap=True)

    def look(policy: str) -> "tuple[SourceSettings, Found]":
        settings = _settings(url, data, user, policy, check_host_name=not trust_server)
        try:
            return settings, asyncio.run(look_around(settings, watch, wanted))
        except SourceRejected as refused:
            if not trust_server or not _trust(data, refused):
                raise
            return settings, asyncio.run(look_around(settings, watch, wanted))

    with working(f"watching for {watch:g} s"):
        settings, found = _by_the_best(look) if security is None else look(security)
    console.print(f"security: {settings.security}", soft_wrap=True)
    for line in connect_lines.left_out(found):
        console.print(line, soft_wrap=True, highlight=False)
    if not found.verdicts:
        raise ConfigurationError(
            f"{url}: no valve was found: U, two pressures and a flow are needed; name their nodes: "
            "--signal=V1.U=NODE --signal=V1.p1=NODE --signal=V1.p2=NODE --signal=V1.Q=NODE"
        )
    console.print(connect_lines.table(found))
    for line in connect_lines.of_valves(found, _command(context)):
        console.print(line, soft_wrap=True, highlight=False)
    is_written = bool(found.accepted) and (yes or not found.open)
    if is_written:
        make_users(data, None)
        pages = {} if sheet is None else {sheet: sheet_page(url, found.accepted, found.unused)}
        pages |= {out: configuration(found, settings, configuration_template(data))}
        for file, text in pages.items():
            write_whole(file, text)
            starts = f"; `valvemap serve --config {out}` starts" if file == out else ""
            console.print(f"written: {file}{starts}", soft_wrap=True)
    _refuse_if_open(found, out, "written without these valves" if is_written else "not written")


def _refuse_if_open(found: "Found", out: Path, what: str) -> None:
    """Raise StorageError if a valve is undecided."""
    if found.open:
        about = "; ".join(f"{v.valve}.{v.question.about}" for v in found.open if v.question)
        raise StorageError(f"{out}: {what}: to be decided: {printable(about, LINE)}")


def _command(context: typer.Context) -> str:
    """Return the command with the options that were given, for a terminal."""
    parts = ["valvemap", "connect", str(context.params["url"])]
    for option in context.command.params:
        given = context.params.get(option.name or "")
        if option.param_type_name != "option" or given in (None, option.get_default(context), ()):
            continue
        name = option.opts[0]
        if given is True:
            parts.append(name)
        else:
            parts += [f"{name}={one}" for one in (given if isinstance(given, list) else [given])]
    return " ".join(shlex.quote(printable(part)) for part in parts)


def _by_the_best(
    look: "Callable[[str], tuple[SourceSettings, Found]]",
) -> "tuple[SourceSettings, Found]":
    """Browse with the best security policy that the server offers."""
    *secured, none = ("Aes256Sha256RsaPss", "Basic256Sha256", "None")
    for policy in secured:
        try:
            return look(policy)
        except SourceRejected as refused:
            if "does not offer" not in str(refused):
                raise
    return look(none)


def _settings(
    url: str, data: Path, user: str | None, security: str, *, check_host_name: bool
) -> "SourceSettings":
    from guarded_opcua import Pki, ensure_certificate
    from valvemap.app.identities import APPLICATION_NAME, APPLICATION_URI
    from valvemap.opcua_client.source_settings import Security, SourceSettings

    try:
        policy = Security(security)
    except ValueError:
        allowed = ", ".join(Security)
        raise typer.BadParameter(f"--security {security}: allowed is one of {allowed}") from None
    password = os.environ.get("VALVEMAP_SOURCE__PASSWORD")
    if policy is Security.NONE:
        return SourceSettings(url, user=user, password=password, application_uri=APPLICATION_URI)
    pki = Pki(data / "pki" / "service")
    names = ("localhost", "127.0.0.1")
    own = ensure_certificate(pki, APPLICATION_URI, names, APPLICATION_NAME.replace(" ", "-"))
    return SourceSettings(
        url, policy, pki, own, user=user, password=password, check_host_name=check_host_name
    )


def _trust(data: Path, refused: SourceRejected) -> bool:
    """Trust the certificate that a refusal names; return False if it names none."""
    from guarded_opcua import Pki
    from guarded_opcua.security.pki_folders import trust

    words = str(refused).split("`valvemap trust ")
    if len(words) < 2:
        return False
    trusted = trust(Pki(data / "pki" / "service"), words[1].split("`")[0])
    write_line(f"trusted: {trusted}")
    return True
