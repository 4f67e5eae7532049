"""Health and metrics, for those who run plants."""

import asyncio

import httpx
from support.shown_service import ShownService

from service.clock import SystemClock
from service.dashboard.settings import PageSettings
from service.dashboard.web import Page

OWN = "http://127.0.0.1:8080"


async def test_alive_is_the_page_ready_is_the_service():
    shown = ShownService(up=False)
    page = Page(shown, lambda *_: (shown, None), PageSettings(), SystemClock())
    looking = asyncio.create_task(page.observer.run())
    transport = httpx.ASGITransport(app=page.guard)
    async with httpx.AsyncClient(transport=transport, base_url=OWN) as browser:
        assert (await browser.get("/livez")).status_code == 200
        assert (await browser.get("/readyz")).status_code == 503
        assert "valvemap_service_up 0.0" in (await browser.get("/metrics")).text
        shown.up = True
        async with asyncio.timeout(10):
            while (await browser.get("/readyz")).status_code != 200:  # noqa: ASYNC110 - as a probe
                await asyncio.sleep(0.05)
        await asyncio.sleep(0.2)
        figures = (await browser.get("/metrics")).text
    looking.cancel()
    await asyncio.gather(looking, return_exceptions=True)
    for line in (
        "valvemap_service_up 1.0",
        'valvemap_valve_severity{valve="V1"} 0.0',
        'valvemap_residual_rmse_litres_per_minute{valve="V1"} 0.2',
        'valvemap_diagnostics_total{valve="V1",what="Late"} 0.0',
        'valvemap_page_refused_total{why="host"} 0.0',
    ):
        assert line in figures, line
