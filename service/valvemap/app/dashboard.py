"""Runs the live page, a separate process from the service."""

import asyncio
from collections.abc import Callable
from dataclasses import replace

from valvemap.app.page_access import Watched, settings_of
from valvemap.clock import SystemClock
from valvemap.opcua_client.results_client import ResultsClient
from valvemap.opcua_results.namespaces import RIG_NAMESPACE, SERVICE_NAMESPACE
from valvemap.page.ports import Client
from valvemap.page.server import open_socket, serve, url_of
from valvemap.page.settings import PageSettings
from valvemap.page.web import Page

_TIMEOUT_S = 3.0  # s; of every request: an outage of the service is shown after this time
_PAST_TIMEOUT_S = 15.0  # s; of a read of the history, which may be long
_FAREWELL_S = 2.0  # s; to close the sessions at the service


async def run_dashboard(
    watched: Watched,
    page_settings: PageSettings,
    stop: asyncio.Event,
    say: Callable[[str], None],
    *,
    any_port: bool = False,
) -> None:
    """Serve the page until ``stop`` is set; ``say`` is called with its URL when it is open.

    Raises
    ------
    ValvemapError
        if the page's address or our certificate cannot be used.
    """
    source = settings_of(watched, _TIMEOUT_S)
    rig_url = watched.rig_url

    def clients(user: str, password: str, address: str) -> tuple[Client, Client | None]:
        own = replace(source, user=user, password=password, on_behalf_of=address)
        rig = None if rig_url is None else replace(own, url=rig_url)
        return (
            ResultsClient(own, SERVICE_NAMESPACE),
            None if rig is None else ResultsClient(rig, RIG_NAMESPACE),
        )

    page = Page(
        ResultsClient(source, SERVICE_NAMESPACE),
        clients,
        page_settings,
        SystemClock(),
        rig_url,
        ResultsClient(settings_of(watched, _PAST_TIMEOUT_S), SERVICE_NAMESPACE),
    )
    await serve_page(page, stop, say, any_port=any_port)


async def serve_page(
    page: Page, stop: asyncio.Event, say: Callable[[str], None], *, any_port: bool = False
) -> None:
    """Serve a page until ``stop`` is set; stops within seconds, even if peers do not respond.

    Raises
    ------
    ValvemapError
        if the page's address cannot be used.
    """
    listening = open_socket(page.settings, or_any=any_port)
    say(url_of(page.settings, listening))
    observing = asyncio.create_task(page.observer.run())
    serving = asyncio.create_task(serve(page.guard, page.settings, listening, stop, page.door))
    try:
        await asyncio.wait({observing, serving}, return_when=asyncio.FIRST_COMPLETED)
        if observing.done():
            observing.result()
    finally:
        stop.set()
        await serving
        observing.cancel()
        ending = {observing, asyncio.create_task(page.log_ins.close())}
        _, silent = await asyncio.wait(ending, timeout=_FAREWELL_S)
        for task in silent:  # the service does not respond: disconnect
            task.cancel()
        await asyncio.gather(*ending, return_exceptions=True)
