"""The tour of a demo leads through three views, covers none, and is done where its links lead."""

from contextlib import asynccontextmanager

import pytest

from support.browser import tab
from support.served_page import served
from support.shown_service import Alarm, ShownService
from valvemap.pipeline.alarm_rules import RULES
from valvemap.pipeline.alarm_rules import Alarm as Alarms

pytestmark = [pytest.mark.chromium, pytest.mark.asyncio(loop_scope="session")]

RIG = "opc.tcp://127.0.0.1:1/rig/"
BELOW = """() => document.querySelector('aside.tour').getBoundingClientRect().top
    >= document.querySelector('main').getBoundingClientRect().bottom - 0.5"""


@asynccontextmanager
async def opened(browser, size=(1280, 800)):
    shown = ShownService(alarms=[Alarm(name="Changed", severity=500)])
    async with served(shown, RIG) as (_, url), tab(browser, url, size=size) as visitor:
        yield visitor


@pytest.mark.parametrize("size", [(1280, 800), (820, 1180), (390, 844)])
async def test_the_tour_covers_nothing_and_is_done_where_its_links_lead(browser, size):
    async with opened(browser, size) as visitor:
        page, step = visitor.page, visitor.page.locator("aside.tour button:last-child")
        await visitor.open("overview")
        for view in ("map", "rig", "alarms"):
            await step.and_(page.get_by_text("Show me").or_(page.get_by_text("Next"))).click()
            await page.locator(f"main[data-view={view}]").wait_for()
            assert await page.evaluate(BELOW)
        await page.locator("main").get_by_text("Trend at that time").click()
        await page.locator("main[data-view=trend]").wait_for()
        await step.and_(page.get_by_text("Done")).click()
        await page.locator("aside.tour").wait_for(state="hidden")
        assert visitor.problems == []


async def test_damage_lasts_unless_told_otherwise(browser):
    async with opened(browser) as visitor:
        await visitor.open("rig")
        kind, duration = (visitor.page.locator(f"[name={x}]") for x in ("kind", "duration"))
        await kind.wait_for()
        assert await duration.input_value() == "0"
        await kind.select_option("offset")
        assert await duration.input_value() == "10"
        await kind.select_option("frozen.p2")  # it is named within the time
        assert float(await duration.input_value()) >= 2 * RULES[Alarms.SENSOR_FROZEN].limit


async def test_a_sentence_has_the_times_of_the_rest_of_the_page(browser):
    since = "since 2027-01-15 08:00:00 UTC"
    shown = ShownService(alarms=[Alarm(text=f"The flow changed by -4.1 l/min, {since}.")])
    place = {"timezone_id": "Europe/Berlin", "locale": "de-DE"}
    async with served(shown, RIG) as (_, url), tab(browser, url, **place) as visitor:
        await visitor.open("alarms")
        measured = await visitor.text(".alarm-detail dd.measured")
        assert "since 15/01/2027 09:00:00." in measured
        assert visitor.problems == []
