"""``valvemap mqtt``: publishes results as Sparkplug B over MQTT, beside any service."""

import asyncio
from pathlib import Path
from typing import Annotated

import typer

from valvemap.cli.logs import set_up_logs
from valvemap.cli.options import (
    ConfigOption,
    FolderOption,
    MetricsHostOption,
    MetricsOption,
    RevocationOption,
    metrics_address,
)
from valvemap.cli.watching import (
    HostNameOption,
    PasswordFileOption,
    SecurityOption,
    watched,
)
from valvemap.config.loading import load_config
from valvemap.errors import ConfigurationError


def mqtt(
    config: ConfigOption = None,
    url: Annotated[
        str | None,
        typer.Option(
            envvar="VALVEMAP_SERVICE_URL",
            help="The service: opc.tcp://HOST:PORT/PATH; default: server.url on this machine.",
        ),
    ] = None,
    data: FolderOption = Path("data"),
    security: SecurityOption = "Basic256Sha256",
    user: Annotated[
        str | None,
        typer.Option(help="User at the service; default: the observer made by `init`."),
    ] = None,
    password_file: PasswordFileOption = None,
    metrics: MetricsOption = None,
    metrics_host_name: MetricsHostOption = None,
    *,
    check_host_name: HostNameOption = True,
    require_crl: RevocationOption = True,
) -> None:
    """Send results to the MQTT broker of [mqtt] as Sparkplug B, until Ctrl-C."""
    loaded, address = load_config(config), metrics_address(metrics, metrics_host_name)
    try:
        from valvemap.app.mqtt import run_mqtt
    except ModuleNotFoundError as error:
        raise ConfigurationError(f"MQTT needs {error.name}: pip install 'valvemap[mqtt]'") from None
    from valvemap.app.signals import stop_on_signal

    service = watched(
        url or loaded.server.url.replace("//0.0.0.0:", "//127.0.0.1:"),
        data,
        security,
        user,
        password_file,
        check_host_name=check_host_name,
        require_crl=require_crl,
    )
    set_up_logs(loaded.log)

    async def until_stopped() -> None:
        stop = asyncio.Event()
        with stop_on_signal(stop):
            await run_mqtt(loaded.mqtt, service, stop, address)

    asyncio.run(until_stopped())
