"""What visitors do that nobody planned: long names, broken links, small and odd screens."""

import pytest

from support.page_visits import SIZES, visit
from support.shown_service import Alarm, ShownService

pytestmark = [pytest.mark.chromium, pytest.mark.asyncio(loop_scope="session")]

LONG = "W" * 64  # the longest that a configuration may have
FAMILY = "V" * 61
VIEWS = (
    *("valve", "trend", "map", "commissioning", "rig"),
    *("alarms", "alarms?show=past", "overview", "timeline"),
)
PARTS = (f"line/{FAMILY}.LineA", f"axis/{LONG}X", f"valve/{FAMILY}.PA")
_SCREENS = {**SIZES, "phone": (390, 844)}
_BEYOND = """() => { // what reaches beyond the window, unless it scrolls within its own box
    const scrolls = (one) => one.closest('.scroll, .rows, .views, pre, code, nav');
    return [...document.querySelectorAll('body *')].filter((one) => one.checkVisibility()
        && !scrolls(one) && one.getBoundingClientRect().right > innerWidth + 1)
        .map((one) => one.outerHTML.slice(0, 120));
}"""


def long_names():
    alarms = [Alarm(source=LONG, name="Changed"), Alarm(source=LONG, name="SensorFrozen")]
    return ShownService(
        names=(LONG, "V1", f"{FAMILY}.PA", f"{FAMILY}.AT"),
        lines=(f"{FAMILY}.LineA",),
        axes=(f"{LONG}X",),
        more=("Commission",),
        alarms=alarms,
        past=alarms,
    )


@pytest.mark.parametrize("size", _SCREENS.values(), ids=_SCREENS)
async def test_the_longest_names_push_nothing_out_of_the_window(browser, size):
    async with visit(browser, long_names(), size=size) as (visitor, _):
        found = {}
        for view in (*VIEWS, *PARTS):
            await visitor.open(f"{view}/{LONG}" if view in VIEWS[:5] else view)
            await visitor.page.locator("main h1").wait_for()
            await visitor.page.wait_for_timeout(800)
            found[view] = await visitor.page.evaluate(_BEYOND)
        assert {view: one for view, one in found.items() if one} == {}
        assert visitor.problems == []


@pytest.mark.parametrize(
    "link",
    ["map/50%", "map/%E0%A4%A", "trend/V1?span=x&end=-1&at=NaN", "alarms?alarm=%", "nowhere/V1"],
)
async def test_a_broken_link_leads_to_a_view(browser, link):
    async with visit(browser, ShownService(names=("V1", "V2"))) as (visitor, _):
        await visitor.open(link)
        await visitor.page.locator("main h1").wait_for()
        await visitor.page.keyboard.press("3")
        await visitor.page.locator("h1", has_text="All valves").wait_for()
        await visitor.page.evaluate("hash => { location.hash = hash; }", f"#/{link}")
        await visitor.page.wait_for_timeout(300)
        await visitor.page.keyboard.press("5")
        await visitor.page.locator("h1", has_text="Time line").wait_for()
        assert visitor.problems == []
