"""The guided run on the page: started, kept alive and aborted by who may, and nothing pretended."""

import asyncio
from contextlib import asynccontextmanager

import pytest

from support.browser import axe, serious, tab
from support.readings import Read
from support.served_page import served
from support.shown_service import ShownService

pytestmark = [pytest.mark.chromium, pytest.mark.asyncio(loop_scope="session")]

START = ("V1.Commission", "Start", ((0.5,),))
RESUME = ("V1.Commission", "Resume", ((0.5,),))
ABORT = ("V1.Commission", "Abort", ((),))


def driven():
    shown = ShownService(more=("Commission",))
    say(shown, 0, "not started")
    return shown


def say(shown, state, progress):
    shown.values["V1.Commission.State"] = Read(state)
    shown.values["V1.Commission.Progress"] = Read(progress)
    shown.values["V1.Commission.Recording"] = Read("data/commission/V1.csv" if state else "")


@asynccontextmanager
async def opened(browser, shown, **given):
    async with served(shown) as (_, url), tab(browser, url, "any", **given) as visitor:
        visitor.page.on("dialog", lambda dialog: asyncio.ensure_future(dialog.accept()))
        await visitor.open("commissioning")
        await visitor.page.locator("h1", has_text="V1").wait_for()
        yield visitor


async def test_a_run_is_started_kept_alive_and_aborted_by_an_operator(browser):
    shown = driven()
    async with opened(browser, shown) as visitor:
        card = visitor.page.locator(".guided-run")
        start, resume, abort = (
            card.get_by_role("button", name=name) for name in ("Start", "Resume", "Abort")
        )
        await card.locator("text=not started").wait_for()
        assert await start.is_disabled()
        await visitor.log_in()
        await visitor.page.locator(
            ".guided-run button:not([disabled])", has_text="Start"
        ).wait_for()
        assert await abort.is_disabled()
        await card.locator("input").fill("0.5")
        await start.click()
        async with asyncio.timeout(20.0):
            while len(shown.writes) < 3:  # noqa: ASYNC110 - no event
                await asyncio.sleep(0.05)
        assert START in shown.calls
        assert {name for name, _ in shown.writes} == {"V1.Commission.Heartbeat"}
        say(shown, 2, "crossing triangles; 3 s, at most 57 s left; map ± 1.2 l/min")
        await card.locator("text=at most 57 s left").wait_for()
        await card.locator("text=Recording: data/commission/V1.csv").wait_for()
        assert await start.is_disabled()
        await abort.click()
        async with asyncio.timeout(20.0):
            while ABORT not in shown.calls:  # noqa: ASYNC110 - no event
                await asyncio.sleep(0.05)
        assert await resume.is_hidden()
        say(shown, 7, "aborted; the operator aborted")
        await card.locator("text=the operator aborted").wait_for()
        written = len(shown.writes)
        await asyncio.sleep(1.5)
        assert len(shown.writes) <= written + 1
        await resume.click()
        async with asyncio.timeout(20.0):
            while RESUME not in shown.calls:  # noqa: ASYNC110 - no event
                await asyncio.sleep(0.05)
        assert visitor.problems == []


async def test_without_the_service_nothing_is_started_and_nothing_said(browser):
    shown = driven()
    async with opened(browser, shown) as visitor:
        await visitor.log_in()
        say(shown, 2, "crossing triangles")
        card = visitor.page.locator(".guided-run")
        await card.locator("text=crossing triangles").wait_for()
        shown.up = False
        await card.locator("text=Not known").wait_for()
        for name in ("Start", "Abort"):
            assert await card.get_by_role("button", name=name).is_disabled()


async def test_a_valve_that_cannot_be_driven_has_no_card(browser):
    async with opened(browser, ShownService()) as visitor:
        await visitor.page.locator(".checks li").first.wait_for()
        assert await visitor.page.locator(".guided-run").is_hidden()


@pytest.mark.parametrize("theme", ["light", "dark"])
async def test_axe_finds_nothing_serious(browser, theme, request):
    shown = driven()
    async with opened(browser, shown, color_scheme=theme) as visitor:
        await visitor.page.locator(f"html[data-theme={theme}]").wait_for()
        await visitor.log_in()
        say(shown, 2, "crossing triangles")
        await visitor.page.locator(".guided-run", has_text="crossing triangles").wait_for()
        assert await serious(visitor, axe(request.config.cache.mkdir("axe"))) == []
