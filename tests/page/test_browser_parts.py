"""Edges, lines and axes in a browser: what the nodes say, written by who may, nothing pretended."""

import re
import time
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest
from playwright.async_api import expect

from support.browser import tab
from support.readings import Read
from support.served_page import served
from support.shown_service import Alarm, ShownService
from valvemap.vocabulary.statuses import AxisStatus

pytestmark = [pytest.mark.chromium, pytest.mark.asyncio(loop_scope="session")]

BAD_NO_COMMUNICATION = 0x8031_0000
EDGES = ("Boom.PA", "Boom.AT", "Boom.PB", "Boom.BT")
LINES = ("Boom.LineA", "Boom.LineB")


def plant(**more):
    return ShownService(names=EDGES, lines=LINES, axes=("Press",), **more)


@asynccontextmanager
async def visit(browser, shown, view):
    async with served(shown) as (page, url), tab(browser, url, "any") as visitor:
        await visitor.open(view)
        await visitor.page.locator("main h1").wait_for()
        yield visitor, page
        assert visitor.problems == []


async def test_the_edges_and_lines_of_a_valve_are_tabs_of_one_view(browser):
    async with visit(browser, plant(), "map/Boom.PA") as (visitor, _):
        tabs = visitor.page.locator(".tabs a")
        assert await tabs.all_inner_texts() == ["PA", "AT", "PB", "BT", "Line A", "Line B"]
        await tabs.nth(2).click()
        await visitor.page.locator("h1", has_text="Boom.PB: map").wait_for()
        await tabs.nth(4).click()
        await visitor.page.locator("h1", has_text="Boom.LineA").wait_for()
        await visitor.page.locator("td", has_text="Identified, and following.").first.wait_for()
        await visitor.page.locator(".tabs a", has_text="BT").click()
        await visitor.page.locator("h1", has_text="Boom.BT").wait_for()


async def test_a_plant_of_axes_alone_begins_with_its_axis(browser):
    async with visit(browser, ShownService(names=(), axes=("Press",)), "") as (visitor, _):
        await visitor.page.locator("h1", has_text="Press").wait_for()
        assert await visitor.page.locator(".views a", has_text="Valve").count() == 0


async def test_a_speed_is_written_and_withdrawn_by_an_operator(browser):
    shown = plant()
    async with visit(browser, shown, "axis/Press") as (visitor, _):
        write = visitor.page.get_by_role("button", name="Write as SpeedDemand")
        assert await write.is_disabled()
        await visitor.log_in()
        await visitor.page.locator(".inverse input[type=number]").fill("120")
        await write.click()
        await visitor.page.locator("[role=status]", has_text="Written").wait_for()
        assert shown.writes == [("Press.Inverse.SpeedDemand", 120.0)]
        shown.values["Press.Inverse.SpeedDemand"] = Read(120.0, 0, shown.t)
        shown.values["Press.Inverse.RequiredU"] = Read(30.0, 0, shown.t)
        said = "In force: SpeedDemand 120 mm/s, RequiredU 30.0 %."
        await visitor.page.locator(".inverse p", has_text=said).wait_for()
        await visitor.page.get_by_role("button", name="Withdraw").click()
        await visitor.page.locator("[role=status]", has_text="is withdrawn").wait_for()


async def test_a_flow_of_a_line_is_written_by_an_operator(browser):
    shown = plant()
    async with visit(browser, shown, "line/Boom.LineA") as (visitor, _):
        await visitor.log_in()
        await visitor.page.get_by_role("button", name="Write as FlowDemand").click()
        await visitor.page.locator("[role=status]", has_text="Written").wait_for()
        assert shown.writes == [
            ("Boom.LineA.Inverse.PressureDrop", 100.0),
            ("Boom.LineA.Inverse.FlowDemand", 60.0),
        ]


async def test_the_axes_with_a_set_position_are_drawn_side_by_side(browser):
    shown = ShownService(names=(), axes=("Fixed", "Living", "Bare"))
    for axis, error in (("Fixed", 3.0), ("Living", 1.0)):
        columns = {"Time": [1.0, 2.0, 3.0], "Position": [error] * 3, "SetPosition": [0.0] * 3}
        for name, value in {"Rms": error, **columns}.items():
            shown.values[f"{axis}.Tracking.{name}"] = Read(value, 0, shown.t)
    async with visit(browser, shown, "axis/Fixed") as (visitor, _):
        card = visitor.page.locator("section", has_text="How the axes follow")
        await card.locator(".legend", has_text="Living 1.00 mm").wait_for()
        assert "Fixed 3.00 mm" in await card.inner_text()
        assert "Bare" not in await card.inner_text()
        assert await card.locator("canvas").count() == 2


@pytest.mark.parametrize("how", ["source lost", "still"])
async def test_an_axis_without_samples_says_so_and_takes_no_demand(browser, how):
    shown = plant()
    async with visit(browser, shown, "axis/Press") as (visitor, _):
        await visitor.log_in()
        badge = visitor.page.locator("main .head .badge")
        await badge.and_(visitor.page.locator("text=ok")).wait_for()
        write = "Write as SpeedDemand"
        await visitor.page.locator("button:enabled", has_text=write).wait_for()
        if how == "still":
            shown.moving = False
        else:
            shown.values["Press.Inverse.RequiredU"] = Read(None, BAD_NO_COMMUNICATION, shown.t)
        await badge.and_(visitor.page.locator("text=no new samples")).wait_for()
        await visitor.page.locator(".sentence", has_text="Since").wait_for()
        await visitor.page.locator("p", has_text="Nothing can be written").wait_for()
        await visitor.page.locator("button:disabled", has_text=write).wait_for()
        shown.moving = True
        shown.values.pop("Press.Inverse.RequiredU", None)
        await badge.and_(visitor.page.locator("text=ok")).wait_for()


class Kept(ShownService):
    """A service whose axis was not excited until five minutes ago, as its history says."""

    async def courses(self, asked, span, every_ns):
        found = await super().courses(asked, span, every_ns)
        for k, ((id_, _), course) in enumerate(zip(asked, found, strict=True)):
            if id_ == "Press.Status":
                ended = time.time_ns() - 300 * 10**9
                values = [float(AxisStatus.UNEXCITED) * (t < ended) for t in course.times]
                found[k] = replace(course, values=values)
        return found


async def test_the_past_of_an_axis_is_in_its_trend_however_long_the_page_has_run(browser):
    worn = Alarm(name="EdgeChanged", source="Press", t=time.time_ns() - 200 * 10**9)
    shown = Kept(names=EDGES, axes=("Press",), alarms=[worn], past=[worn])
    async with visit(browser, shown, "axis/Press") as (visitor, _):
        lanes = visitor.page.locator(".axis-trend canvas.lanes")
        said = "State and alarms: not excited from .* to .*; ok from .*; Edge changed from"
        await expect(lanes).to_have_attribute("aria-label", re.compile(said))
        await visitor.open("alarms")
        link = visitor.page.get_by_role("link", name="Trend at that time")
        assert await visitor.page.get_by_role("link", name="Line", exact=True).count() == 0
        await link.click()
        await visitor.page.locator("h1", has_text="Press").wait_for()
        assert f"at={round(worn.t / 1e9)}" in visitor.page.url
        await expect(lanes).to_have_attribute("aria-label", re.compile("Edge changed from"))


async def test_an_axis_of_a_service_without_a_history_says_so(browser):
    async with visit(browser, plant(keeps_history=False), "axis/Press") as (visitor, _):
        await visitor.page.locator(".axis-trend", has_text="keeps no history").wait_for()


async def test_the_sheet_tells_how_it_is_made(browser):
    shown = ShownService(names=("V1",), more=("Commission",))
    shown.values["V1.Commission.State"] = Read(6)
    shown.values["V1.Commission.Recording"] = Read("data/commission/V1.csv")
    async with visit(browser, shown, "commissioning/V1") as (visitor, _):
        card = visitor.page.locator(".sheet")
        await card.locator("p", has_text="data/commission/V1.csv").wait_for()
        told = await card.locator("code").inner_text()
        assert told == "valvemap sheet V1 --config valvemap.toml --out V1.html"
