"""What hinders people, as axe-core finds it: in every view, theme and size; with data lost, too."""

import pytest

from support.browser import axe, serious
from support.page_visits import SIZES, VIEWS, alarmed, visit

pytestmark = [pytest.mark.chromium, pytest.mark.asyncio(loop_scope="session")]


@pytest.mark.parametrize("view", [*VIEWS, "alarms?show=past"])
async def test_axe_finds_nothing_serious_in_any_theme_and_size(browser, view, request):
    shown, _ = alarmed()
    async with visit(browser, shown, color_scheme="dark") as (visitor, _):
        await visitor.open(view)
        await visitor.page.wait_for_timeout(1_000)
        await check(visitor, request)
        assert visitor.problems == []


@pytest.mark.parametrize("view", VIEWS)
async def test_axe_finds_nothing_serious_once_the_service_is_gone(browser, view, request):
    shown, _ = alarmed()
    async with visit(browser, shown, color_scheme="dark") as (visitor, _):
        await visitor.open(view)
        await visitor.page.locator("main h1").wait_for()
        shown.up = False
        await visitor.page.locator(".strip", has_text="What you see is old").wait_for()
        await visitor.page.wait_for_timeout(1_500)
        await check(visitor, request)


async def test_axe_finds_nothing_serious_in_what_opens_over_a_view(browser, request):
    shown, _ = alarmed()
    async with visit(browser, shown, color_scheme="dark") as (visitor, _):
        await visitor.open("map/V1")
        await visitor.page.locator(".units summary").click()
        await check(visitor, request)
        await visitor.page.locator("button.user").click()
        await visitor.page.locator("dialog[open]").wait_for()
        assert await serious(visitor, axe(request.config.cache.mkdir("axe"))) == []


async def check(visitor, request):
    """Look with axe in both themes, dark first, and at all sizes."""
    page, script = visitor.page, axe(request.config.cache.mkdir("axe"))
    for theme in ("dark", "light"):
        await page.locator(f"html[data-theme={theme}]").wait_for()
        for size, (width, height) in SIZES.items():
            await page.set_viewport_size({"width": width, "height": height})
            await page.wait_for_timeout(100)
            assert await serious(visitor, script) == [], (theme, size)
        await page.locator("button.theme").click()
        await page.wait_for_timeout(400)  # a lamp's colour changes in 300 ms
