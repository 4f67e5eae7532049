"""The live page from start to end: a process of its own, beside any service."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from service.app.identities import PAGE_NAME, PAGE_URI
from service.clock import SystemClock
from service.dashboard.ports import Client
from service.dashboard.server import open_socket, serve, url_of
from service.dashboard.settings import PageSettings
from service.dashboard.web import Page
from service.hardened.security.certificates import Pki, ensure_certificate
from service.opcua.results_client import ResultsClient, Security, SourceSettings

_SERVICE_NAMESPACE, _RIG_NAMESPACE = "urn:valvemap:service", "urn:valvemap:rig"
_TIMEOUT_S = 3.0  # for every answer: a service that is gone shows after so long


@dataclass(frozen=True)
class Watched:
    """The service that the page looks at.

    ``rig_url`` is that of a demo's rig; ``pki`` holds our certificate unless ``security`` is NONE.
    """

    url: str
    security: Security
    pki: Path
    user: str | None = None
    password: str | None = None
    rig_url: str | None = None
    check_host_name: bool = True
    require_crl: bool = True


async def run_dashboard(
    watched: Watched,
    page_settings: PageSettings,
    stop: asyncio.Event,
    say: Callable[[str], None],
    *,
    any_port: bool = False,
) -> None:
    """Serve the page until ``stop`` is set; ``say`` where, once it can be opened.

    Raises
    ------
    ValvemapError
        of the page's address, or of our certificate.
    """
    source = _source_settings(watched)
    rig_url = watched.rig_url

    def clients(user: str, password: str) -> tuple[Client, Client | None]:
        own = replace(source, user=user, password=password)
        rig = None if rig_url is None else replace(own, url=rig_url)
        return (
            ResultsClient(own, _SERVICE_NAMESPACE),
            None if rig is None else ResultsClient(rig, _RIG_NAMESPACE),
        )

    clock = SystemClock()
    page = Page(ResultsClient(source, _SERVICE_NAMESPACE), clients, page_settings, clock, rig_url)
    listening = open_socket(page_settings, or_any=any_port)
    say(url_of(page_settings, listening))
    observing = asyncio.create_task(page.observer.run())
    serving = asyncio.create_task(serve(page.guard, page_settings, listening, stop))
    try:
        await asyncio.wait({observing, serving}, return_when=asyncio.FIRST_COMPLETED)
        if observing.done():
            observing.result()
    finally:
        stop.set()
        await serving
        observing.cancel()
        with suppress(asyncio.CancelledError):
            await observing
        await page.log_ins.close()


def _source_settings(watched: Watched) -> SourceSettings:
    own = None
    if watched.security is not Security.NONE:
        file_name = PAGE_NAME.replace(" ", "-")
        names = ("localhost", "127.0.0.1")
        own = ensure_certificate(Pki(watched.pki), PAGE_URI, names, file_name)
    return SourceSettings(
        url=watched.url,
        security=watched.security,
        pki=None if own is None else Pki(watched.pki),
        own=own,
        user=watched.user,
        password=watched.password,
        check_host_name=watched.check_host_name,
        require_crl=watched.require_crl,
        application_uri=None if own is not None else PAGE_URI,
        timeout_s=_TIMEOUT_S,
    )
