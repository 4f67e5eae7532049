"""The page's memory in a browser: trends, alarms, units; and that nothing pretends."""

import time
from contextlib import asynccontextmanager

import pytest

from support.browser import Visit, axe, chromium, serious
from support.readings import Read
from support.served_page import served
from support.shown_service import Alarm, ShownService

pytestmark = pytest.mark.chromium

S = 1_000_000_000
VIEWS = ("valve", "trend", "map", "alarms", "overview", "commissioning", "timeline")
_PLANT = tuple(f"V{k}" for k in range(1, 13))
_HEIGHT = """() => {
    const view = document.querySelector('main');
    const low = [...view.querySelectorAll('.card')].map(c => c.getBoundingClientRect().bottom);
    return Math.min(Math.max(...low), innerHeight) / innerHeight;
}"""


@asynccontextmanager
async def visit(shown, theme="light", size=(1280, 800)):
    async with served(shown) as (page, url), chromium() as browser:
        width, height = size
        view = {"width": width, "height": height}
        context = await browser.new_context(viewport=view, color_scheme=theme)
        yield Visit(await context.new_page(), url), page


def alarmed():
    now = time.time_ns()
    frozen = Alarm(
        name="SensorFrozen",
        severity=700,
        t=now - 600 * S,
        text="p2 was constant to the last digit for 34.0 s while other signals varied (limit 10 s),"
        " since 2026-11-25 22:20:10 UTC. It may be: a dead sensor; a coarse resolution.",
    )
    shown = ShownService(names=("V1", "V2"), alarms=[frozen], past=[frozen])
    shown.values["V1.DeviceHealth"] = Read(1)
    return shown, frozen


async def test_a_trend_is_there_after_a_change_of_view_a_reload_and_in_another_browser():
    shown, _ = alarmed()
    async with visit(shown) as (visitor, _):
        await visitor.open("trend/V1?span=3600")
        page = visitor.page
        value = page.locator(".readout td.value").first
        await page.locator(".readout td.value", has_text="–").first.wait_for(state="hidden")
        await page.keyboard.press("ArrowLeft")
        await page.locator(".badge", has_text="past").wait_for()
        kept = await page.evaluate("location.hash")
        assert "end=" in kept
        await page.keyboard.press("3")
        await page.locator("h1", has_text="All valves").wait_for()
        await page.keyboard.press("t")
        await page.locator("h1", has_text="trend").wait_for()
        assert await page.evaluate("location.hash") == kept
        await page.reload()
        await value.wait_for()
        assert await page.evaluate("location.hash") == kept
        assert visitor.problems == []


async def test_without_a_history_the_trend_says_so():
    async with visit(ShownService(keeps_history=False)) as (visitor, _):
        await visitor.open("trend/V1")
        note = visitor.page.locator("[role=status]", has_text="keeps no history")
        await note.wait_for()
        assert "since" in await note.inner_text()


async def test_what_happened_when_and_what_now_by_keyboard():
    shown, _ = alarmed()
    async with visit(shown) as (visitor, _):
        page = visitor.page
        await visitor.open("valve")
        await page.locator("h1", has_text="V1").wait_for()
        await page.keyboard.press("a")
        detail = page.locator(".alarm-detail")
        await detail.locator("dd", has_text="p2 was constant").wait_for()
        told = await detail.inner_text()
        for said in ("for 34.0 s", "a dead sensor", "Check the named sensor", "10 min"):
            assert said in told
        link = page.locator("a", has_text="Trend at that time")
        while not await link.evaluate("a => a === document.activeElement"):
            await page.keyboard.press("Tab")
        await page.keyboard.press("Enter")
        await page.locator(".marks .badge", has_text="Sensor frozen").wait_for()
        assert visitor.problems == []


async def test_an_alarm_is_acknowledged_by_who_may():
    shown, _ = alarmed()
    async with visit(shown) as (visitor, _):
        visitor.password = "any"
        await visitor.open("alarms")
        button = visitor.page.get_by_role("button", name="Acknowledge", exact=True)
        await button.wait_for()
        assert await button.is_disabled()
        await visitor.log_in()
        await visitor.page.locator("input[name=comment]").fill("cable")
        await button.click()
        await visitor.page.locator("[role=status]", has_text="Acknowledged").wait_for()
        assert shown.calls[-1] == ("V1.Alarms.SensorFrozen", "Acknowledge", (("cable",),))


@pytest.mark.parametrize("view", VIEWS)
async def test_without_the_service_nothing_says_ok_and_nothing_can_be_written(view):
    shown, _ = alarmed()
    async with visit(shown) as (visitor, _):
        visitor.password = "any"
        page = visitor.page
        await visitor.open(view)
        await page.locator(".link[data-link=up]").wait_for()
        await visitor.log_in()
        await page.locator("main h1").wait_for()
        await page.wait_for_timeout(1_500)
        shown.up = False
        await page.locator(".strip", has_text="since").wait_for()
        await page.wait_for_timeout(1_500)
        words = (await page.locator("main").inner_text()).lower().split()
        assert not {"ok", "ok:", "good"} & set(words)
        badges = await page.locator("main .badge[data-severity='0']:visible").all_inner_texts()
        assert [b for b in badges if b != "service"] == []
        for writes in ("Write as FlowDemand", "Acknowledge", "Confirm", "Approve this map"):
            for button in await page.get_by_role("button", name=writes, exact=True).all():
                assert await button.is_disabled(), writes
        shown.up = True
        await page.locator(".link[data-link=up]").wait_for()
        await page.locator("main:not([data-stale=true])").wait_for()
        assert visitor.problems == []


async def test_a_valve_without_samples_is_not_ok_and_no_demand_is_written_for_it():
    shown = ShownService(moving=False)
    async with visit(shown) as (visitor, _):
        visitor.password = "any"
        await visitor.open("map")
        write = visitor.page.locator("button", has_text="Write as FlowDemand")
        await visitor.log_in()
        await visitor.page.locator("p", has_text="Nothing can be written").wait_for()
        assert await write.is_disabled()


async def test_units_are_the_same_everywhere_and_kept():
    async with visit(ShownService()) as (visitor, _):
        page = visitor.page
        await visitor.open("valve")
        await page.locator(".signal[data-signal=dp]", has_text="100.0").wait_for()
        await page.locator(".units summary").click()
        await page.locator(".units select[name=pressure]").select_option("psi")
        await page.locator(".units select[name=flow]").select_option("m³/h")
        await page.locator(".signal[data-signal=dp]", has_text="1450").wait_for()
        await page.locator(".signal[data-signal=Q]", has_text="3.6").wait_for()
        await page.reload()
        await page.locator(".signal[data-signal=dp]", has_text="psi").wait_for()
        await visitor.open("overview")
        await page.locator("th", has_text="RMSE, m³/h").wait_for()
        await visitor.open("map")
        await page.locator("output", has_text="1450 psi").first.wait_for()


@pytest.mark.parametrize("view", ["valve/V1", "map/V1", "alarms", "overview", "trend/V1"])
async def test_a_large_screen_is_used(view):
    async with visit(ShownService(names=_PLANT), size=(1920, 1080)) as (visitor, _):
        await visitor.open(view)
        await visitor.page.locator("main h1").wait_for()
        await visitor.page.wait_for_timeout(1_500)
        assert await visitor.page.evaluate(_HEIGHT) >= 0.75


async def test_the_worst_valve_is_first_with_its_health_and_alarms_beside():
    shown, _ = alarmed()
    async with visit(shown) as (visitor, _):
        await visitor.open("overview")
        rows = visitor.page.locator(".rows tbody tr:has(a)")
        await rows.nth(0).and_(visitor.page.locator("tr", has_text="failure")).wait_for()
        assert "V1" in await rows.nth(0).inner_text()
        await visitor.page.locator(".needs a", has_text="Sensor frozen").wait_for()


@pytest.mark.parametrize("theme", ["light", "dark"])
async def test_axe_finds_nothing_serious_in_the_views_of_the_past(theme, request):
    script = axe(request.config.cache.mkdir("axe"))
    shown, _ = alarmed()
    async with visit(shown, theme) as (visitor, _):
        for view in ("trend", "alarms", "alarms?show=past", "overview"):
            await visitor.open(view)
            await visitor.page.wait_for_timeout(1_500)
            assert await serious(visitor, script) == []
        assert visitor.problems == []
