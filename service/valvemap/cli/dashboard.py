"""``valvemap dashboard``: the live page, as a separate process beside any service."""

import asyncio
from pathlib import Path
from typing import Annotated

import typer

from valvemap.cli.options import FolderOption, RevocationOption, address_and_port
from valvemap.cli.output import write_line
from valvemap.cli.watching import (
    HostNameOption,
    PasswordFileOption,
    SecurityOption,
    watched,
)
from valvemap.errors import ConfigurationError

URL = "opc.tcp://127.0.0.1:4841/valvemap/service/"
LISTEN = "127.0.0.1:8080"


def dashboard(
    url: Annotated[
        str,
        typer.Option(envvar="VALVEMAP_SERVICE_URL", help="The service: opc.tcp://HOST:PORT/PATH"),
    ] = URL,
    listen: Annotated[
        str,
        typer.Option(envvar="VALVEMAP_PAGE_LISTEN", metavar="ADDRESS:PORT", help="Of the page."),
    ] = LISTEN,
    host_name: Annotated[
        list[str] | None,
        typer.Option(
            envvar="VALVEMAP_PAGE_HOSTS",
            help="Name under which browsers reach it, if not this host.",
        ),
    ] = None,
    certificate: Annotated[
        Path | None,
        typer.Option(
            envvar="VALVEMAP_PAGE_CERTIFICATE", metavar="FILE.pem", help="For https; with --key."
        ),
    ] = None,
    key: Annotated[
        Path | None, typer.Option(envvar="VALVEMAP_PAGE_KEY", metavar="FILE.pem")
    ] = None,
    data: FolderOption = Path("data"),
    security: SecurityOption = "Basic256Sha256",
    user: Annotated[
        str | None, typer.Option(help="User name; default: the one made by `init`.")
    ] = None,
    password_file: PasswordFileOption = None,
    rig_url: Annotated[
        str | None, typer.Option(help="Address of a virtual rig, for the page's rig view.")
    ] = None,
    *,
    check_host_name: HostNameOption = True,
    require_crl: RevocationOption = True,
    under_demo: Annotated[bool, typer.Option("--under-demo", hidden=True)] = False,
) -> None:
    """Serve the live page, until Ctrl-C."""
    try:
        from valvemap.app.dashboard import run_dashboard
        from valvemap.page.settings import PageSettings
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"the page needs {error.name}: pip install 'valvemap[dashboard]'"
        ) from None
    from valvemap.app.signals import stop_on_signal, stop_with_parent

    service = watched(
        url,
        data,
        security,
        user,
        password_file,
        check_host_name=check_host_name,
        require_crl=require_crl,
        rig_url=rig_url,
    )
    address, port = address_and_port(listen)
    page = PageSettings(address, port, tuple(host_name or ()), certificate, key)

    async def until_stopped() -> None:
        stop = asyncio.Event()
        if under_demo:
            stop_with_parent(stop)
        with stop_on_signal(stop):
            await run_dashboard(service, page, stop, _say, any_port=under_demo)

    asyncio.run(until_stopped())


def _say(url: str) -> None:
    write_line(url)  # the parent process waits for it
