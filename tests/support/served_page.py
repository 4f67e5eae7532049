"""The page, served within the test's own process."""

import asyncio
from contextlib import asynccontextmanager

from valvemap.clock import SystemClock
from valvemap.page.server import open_socket, serve, url_of
from valvemap.page.settings import PageSettings
from valvemap.page.web import Page


@asynccontextmanager
async def served(shown, rig=None, **settings):
    """The page of a service on a free port: (Page, URL); users log in to the same service.

    With a URL of a rig, the page is that of a demo.
    """
    own = PageSettings(**{"port": 0, **settings})
    page = Page(shown, lambda *_: (shown, shown if rig else None), own, SystemClock(), rig)
    listening, stop = open_socket(own), asyncio.Event()
    tasks = [
        asyncio.create_task(serve(page.guard, own, listening, stop, page.door)),
        asyncio.create_task(page.observer.run()),
    ]
    try:
        yield page, url_of(own, listening)
    finally:
        stop.set()
        await tasks[0]
        tasks[1].cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
