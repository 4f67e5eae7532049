"""Health and metrics, for those who run plants."""

import asyncio
import math
from importlib.metadata import version

import httpx
from asyncua import ua

from support.readings import Read
from support.shown_service import Alarm, ShownService
from valvemap.clock import ManualClock, SystemClock
from valvemap.opcua_results.service_variables import service_variables
from valvemap.page.figures import SERVICE, SUMMARY, Figures
from valvemap.page.layout import Valve
from valvemap.page.settings import PageSettings
from valvemap.page.web import Page

OWN = "http://127.0.0.1:8080"


def test_the_server_s_own_counts_are_asked_by_the_standard_s_numbers():
    prefix = "Server_ServerDiagnostics_ServerDiagnosticsSummary_"
    assert {name: getattr(ua.ObjectIds, prefix + name) for name in SUMMARY} == SUMMARY


def test_everything_that_the_service_shows_of_itself_is_asked_for():
    shown = [node for nodes in service_variables().values() for node in nodes]
    there = {node.id for node in shown if node.kind != ua.VariantType.String}
    assert {f"Service.{name}" for name in SERVICE} == there


async def test_a_figure_that_is_bad_or_no_number_is_left_out():
    shown = ShownService()
    shown.values["V1.Diagnostics.SampleAge"] = Read(math.nan)
    shown.values["Service.Checkpoint.Age"] = Read(0.0, 0x80320000)
    figures = Figures(shown, SystemClock())
    await figures.look([Valve("V1", ("RLS",), ())])
    assert ("V1", "SampleAge") not in figures.valves
    assert figures.valves["V1", "Pending"] == 3.0
    assert "Checkpoint.Age" not in figures.service
    assert "Checkpoint.Size" in figures.service


async def test_however_often_figures_are_asked_for_the_service_is_asked_once_a_second():
    shown, clock = ShownService(), ManualClock()
    figures = Figures(shown, clock)
    await figures.look([Valve("V1", ("RLS",), ())])
    read = shown.reads
    await figures.look([Valve("V1", ("RLS",), ())])
    assert shown.reads == read


async def test_alive_is_the_page_ready_is_the_service():
    shown = ShownService(up=False)
    shown.alarms.append(Alarm())
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
        'valvemap_alarm_severity{alarm="Changed",source="V1"} 600.0',
        'valvemap_alarm_unacknowledged{alarm="Changed",source="V1"} 1.0',
        f'valvemap_build_info{{version="{version("valvemap")}"}} 1.0',
        'valvemap_residual_rmse_litres_per_minute{valve="V1"} 0.2',
        'valvemap_diagnostics_total{valve="V1",what="Late"} 0.0',
        'valvemap_pending_samples{valve="V1"} 3.0',
        'valvemap_sample_age_seconds{valve="V1"} 0.05',
        'valvemap_lag_seconds{of="Q",valve="V1"} 0.2',
        "valvemap_checkpoint_age_seconds 4.0",
        "valvemap_checkpoint_failures_total 1.0",
        "valvemap_checkpoint_bytes 4096.0",
        'valvemap_source_total{what="Overflows"} 2.0',
        "valvemap_sessions 7.0",
        'valvemap_refused_total{what="requests"} 18.0',
        'valvemap_page_refused_total{why="host"} 0.0',
    ):
        assert line in figures, line
