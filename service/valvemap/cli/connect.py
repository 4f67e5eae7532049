"""``valvemap connect``: writes a configuration from a server's address."""

import asyncio
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from valvemap.cli.options import FolderOption, new_file
from valvemap.cli.output import terminal, write_line
from valvemap.cli.progress import working
from valvemap.cli.security import make_users
from valvemap.errors import ConfigurationError, SourceRejected, StorageError
from valvemap.foreign_text import printable
from valvemap.owned_files import write_whole

if TYPE_CHECKING:
    from collections.abc import Callable

    from valvemap.app.connect import Found
    from valvemap.opcua_source.client import SourceSettings

_WATCH_S = 30.0
_MOST_SKIPPED = 20  # lines; further ones are counted only


def connect(
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
    *,
    force: Annotated[
        bool, typer.Option("--force", "--yes", is_eager=True, help="Replace FILE if it exists.")
    ] = False,
    trust_server: Annotated[
        bool, typer.Option("--trust-server", help="Trust the certificate that the server shows.")
    ] = False,
) -> None:
    """Find the valves of a server, check their signals, write a configuration."""
    from valvemap.app.connect import configuration, look_around, without_unit
    from valvemap.config.template import configuration_template

    console = terminal()
    console.print(f"looking around at {url}, then watching for {watch:g} s ...", soft_wrap=True)

    def look(policy: str) -> "tuple[SourceSettings, Found]":
        settings = _settings(url, data, user, policy, check_host_name=not trust_server)
        try:
            return settings, asyncio.run(look_around(settings, watch))
        except SourceRejected as refused:
            if not trust_server or not _trust(data, refused):
                raise
            return settings, asyncio.run(look_around(settings, watch))

    with working(f"watching for {watch:g} s"):
        settings, found = _by_the_best(look) if security is None else look(security)
    console.print(f"security: {settings.security}", soft_wrap=True)
    for line in _skipped(found):
        console.print(f"skipped: {line}", soft_wrap=True)
    if not found.valves:
        raise ConfigurationError(
            f"{url}: no valve was found: U, two pressures and a flow are needed; write "
            "[valves.nodes] by hand: `valvemap init` makes a configuration to begin with"
        )
    console.print(_table(found))
    make_users(data, None)
    write_whole(out, configuration(found, settings, configuration_template(data)))
    for valve in found.valves:
        if roles := without_unit(valve):
            unsaid = f"{valve.name}: the server says no unit of {', '.join(roles)};"
            console.print(f"{unsaid} {out} says what is taken for it", soft_wrap=True)
    console.print(f"written: {out}; `valvemap serve --config {out}` starts", soft_wrap=True)
    if found.questions:
        raise StorageError(f"{out}: to be decided: {'; '.join(found.questions)}")


def _skipped(found: "Found") -> list[str]:
    """Return lines for the unusable nodes, at most ``_MOST_SKIPPED``."""
    more = len(found.skipped) - _MOST_SKIPPED
    return [*found.skipped[:_MOST_SKIPPED], *([f"{more:,} more"] if more > 0 else [])]


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
    from valvemap.opcua_source.client import Security, SourceSettings

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
    from guarded_opcua.security.certificates import trust

    words = str(refused).split("`valvemap trust ")
    if len(words) < 2:
        return False
    trusted = trust(Pki(data / "pki" / "service"), words[1].split("`")[0])
    write_line(f"trusted: {trusted}")
    return True


def _table(found: "Found") -> Table:
    """Table of the signals; it fits a terminal of 80 columns if names are short."""
    beginning = _beginning([node.node for valve in found.valves for node in valve.nodes.values()])
    nodes = f"; nodes begin with {beginning}" if beginning else ""
    table = Table(
        title=f"Values seen{nodes}", title_justify="left", box=SIMPLE_HEAD, pad_edge=False
    )
    table.add_column("signal", no_wrap=True)
    for heading in ("rate\nHz", "skew\nms", "comes", "good\n%", "mean", "noise"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("node", overflow="fold")
    for valve in found.valves:
        table.add_row(Text(printable(valve.name), style="bold"))
        for role, node in valve.nodes.items():
            seen = found.watched.get(valve.name, {}).get(role)
            figures = ["", "", "", "", "", ""]
            if seen is not None:
                comes = "on change" if seen.on_change else "cyclic"
                numbers = seen.rate_hz, seen.skew_ms, 100.0 * seen.good, seen.mean, seen.noise
                rate, skew, good, mean, noise = (f"{number:.3g}" for number in numbers)
                figures = [rate, skew, comes, good, mean, noise]
            table.add_row(role, *figures, printable(node.node.removeprefix(beginning)))
    return table


def _beginning(nodes: list[str]) -> str:
    """Return the common prefix of all NodeIds up to ``s=`` or ``i=``; empty if they differ.

    >>> _beginning(["nsu=urn:plc;s=FCV.U", "nsu=urn:plc;s=FCV.Q"])
    'nsu=urn:plc;s='
    """
    found = {node[: node.find(";", 1) + 3] for node in nodes if node[:2] == "ns"}
    return found.pop() if len(found) == 1 else ""
