"""What an operator asks, by keyboard alone, in at most three actions; answers are the nodes'."""

import re
import time
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest

from support.browser import tab
from support.keyboard import Keyboard
from support.readings import Read
from support.served_page import served
from support.shown_parts import AXIS, LINE
from support.shown_service import Alarm, ShownService
from valvemap.page.judgement import Severity

pytestmark = [pytest.mark.chromium, pytest.mark.asyncio(loop_scope="session")]

S = 1_000_000_000
BAD_SENSOR_FAILURE = 0x808C_0000
SINCE = "2026-11-25 22:20:10"
_KINDS = "items => items.map(item => item.dataset.kind)"


def plant():
    frozen = Alarm(
        name="SensorFrozen",
        severity=700,
        t=time.time_ns() - 1_500 * S,
        text="p2 was constant to the last digit for 34.0 s while other signals varied (limit 10 s),"
        f" since {SINCE} UTC. It may be: a dead sensor; a coarse resolution.",
    )
    return ShownService(
        names=("V1", "Boom.PA", "Boom.AT"),
        lines=("Boom.LineA",),
        axes=("Press",),
        alarms=[frozen],
        past=[frozen],
    )


@asynccontextmanager
async def asked(browser, shown):
    async with served(shown) as (page, url), tab(browser, url) as visitor:
        await visitor.open("valve/V1")
        await visitor.page.locator("main h1").wait_for()
        await visitor.page.locator(".signals .value", has_text="60.0").wait_for()
        yield visitor.page, Keyboard(visitor.page), page.observer
        assert visitor.problems == []


async def as_shown(page, text):
    """A sentence of the service with its time in the browser's zone."""
    local = """at => { const date = new Date(at);
        return `${date.toLocaleDateString("en-GB")} ${date.toLocaleTimeString("en-GB")}` }"""
    return text.replace(f"{SINCE} UTC", await page.evaluate(local, f"{SINCE.replace(' ', 'T')}Z"))


async def test_how_long_has_p2_been_frozen_and_what_to_check(browser):
    shown = plant()
    async with asked(browser, shown) as (page, keys, _):
        detail = await frozen_alarm(page, keys)
        minutes = round((time.time_ns() - shown.alarms[0].t) / 60 / S)
        told = await detail.inner_text()
        assert f"{minutes} min" in told
        assert await as_shown(page, shown.alarms[0].text.split(" It may be")[0]) in told
        assert "Check the named sensor" in told


async def test_may_i_trust_60_l_min_at_120_bar(browser):
    shown = plant()
    async with asked(browser, shown) as (page, keys, observer):
        await keys.press("q")
        await page.locator(".inverse input[type=number]:focus").wait_for()
        await keys.type("60")
        await page.keyboard.press("Tab")  # over the slider of the pressure drop
        await keys.type("120")
        await page.locator(".answer .value[data-for='60@120']").wait_for()
        ((U, lower, upper, _),) = await observer.client.call(
            "V1.Inverse", "Invert", [(60.0, 120.0, 0.0)]
        )
        told = await page.locator(".inverse").inner_text()
        assert f"{U:.2f} %" in told
        assert f"95 %: {lower:.2f} to {upper:.2f} %" in told
        assert "U delivers the demanded flow at this pressure drop." in told
        assert shown.writes == []


async def test_how_far_is_the_map_from_the_approved_one_and_where(browser):
    shown = plant()
    shown.values["V1.Baseline.Version"] = Read("7")
    async with asked(browser, shown) as (page, keys, observer):
        await keys.press("2")
        words = page.locator(".before p", has_text="on average")
        await words.wait_for()
        ((mean, largest, U, dp, points),) = await observer.client.call(
            "V1.Baseline", "Compare", [["RLS"]]
        )
        told = (await words.inner_text()).replace("−", "-")
        for part in ("version 7", f"{mean:.1f} l/min", f"{largest:.1f} l/min at U {U:.0f} %"):
            assert part in told
        assert f"{dp:.0f} bar; {points} points" in told


async def test_what_did_the_flow_do_in_the_last_hour(browser):
    shown = plant()
    async with asked(browser, shown) as (page, keys, _):
        await keys.press("t")
        await keys.open(page.locator("button[data-span='3600000']"))
        row = page.locator(".readout tr:has(td)").first
        await page.locator(".segments [aria-pressed=true]", has_text="1 h").wait_for()
        await row.locator("td", has_text="99.0").first.wait_for()  # the courses count to 99
        assert (await row.locator("td").all_inner_texts())[2] == "0.0"


async def test_which_valve_is_this_among_many(browser):
    shown = plant()
    shown.names = tuple(f"V{k}" for k in range(1, 40))
    async with asked(browser, shown) as (page, keys, _):
        await keys.press("/")
        await page.locator("input[type=search]:focus").wait_for()
        await page.keyboard.type("V37")
        await keys.press("Enter")
        await page.locator("main h1", has_text="V37").wait_for()


async def test_how_soft_is_the_oil_of_an_axis_and_how_sure_is_that(browser):
    async with asked(browser, plant()) as (page, keys, _):
        await keys.press("x")
        row = page.locator(".described tr", has_text="Bulk modulus")
        await row.wait_for()
        told = await row.inner_text()
        assert f"{AXIS['BulkModulus']:.5f}" in told
        assert f"{1.96 * AXIS['BulkModulusStd']:.5f}" in told
        assert "GPa" in told


async def test_which_u_does_a_speed_demand(browser):
    async with asked(browser, plant()) as (page, keys, observer):
        await keys.press("x")
        await page.locator("h1", has_text="Press").wait_for()
        await keys.press("q")
        await keys.type("-80")
        await page.locator(".answer .value[data-for='-80']").wait_for()
        ((U, *_),) = await observer.client.call("Press.Inverse", "Invert", [(-80.0, *[0.0] * 5)])
        told = await page.locator(".inverse").inner_text()
        assert f"{U:.2f} %".replace("-", "−") in told
        assert "U delivers the demanded speed" in told


async def test_which_edge_passes_the_flow_and_how_much_leaks(browser):
    async with asked(browser, plant()) as (page, keys, _):
        await page.locator(".which input").fill("Boom.PA")
        await page.locator(".which input").press("Enter")
        await page.locator("h1", has_text="Boom.PA").wait_for()
        await keys.open(page.locator(".tabs a", has_text="Line A"))
        await page.locator(".inverse p", has_text="Edge in use: P to A").wait_for()
        row = page.locator(".described tr", has_text="Leakage")
        assert f"{LINE['Leakage']:.5f}" in await row.inner_text()


async def test_what_happened_when_and_what_now(browser):
    shown = plant()
    async with asked(browser, shown) as (page, keys, _):
        detail = await frozen_alarm(page, keys)
        told, (frozen,) = await detail.inner_text(), shown.alarms
        text = await as_shown(page, frozen.text)
        measured, _, cause = text.rstrip(".").partition(" It may be: ")
        for said in (measured, *cause.split("; "), "Check the named sensor"):
            assert said in told
        begun = await time_of_day(page, frozen.t)
        assert begun in told
        await keys.open(page.locator("a", has_text="Trend at that time"))
        await page.locator(".marks li", has_text="Sensor frozen").wait_for()
        assert begun in await page.locator(".marks li", has_text="Sensor frozen").inner_text()


async def test_which_valve_is_worst_why_and_since_when(browser):
    shown = plant()
    shown.values["Boom.AT.RLS.PredictedFlow"] = Read(1.0, BAD_SENSOR_FAILURE)
    async with asked(browser, shown) as (page, keys, observer):
        await keys.press("3")
        first = page.locator(".rows tbody tr:has(a)").first
        await first.locator("a", has_text="Boom.AT").wait_for()
        told = await first.inner_text()
        assert "A sensor has failed." in told
        (row,) = [r for r in observer.standings.rows.values() if r.reason.label == "sensor failed"]
        assert await time_of_day(page, row.since) in told


async def test_what_is_missing_for_a_map_and_which_point_is_next(browser):
    shown = plant()
    shown.values["V1.RLS.SuggestedU"] = Read(80.0)
    shown.values["V1.RLS.SuggestedDp"] = Read(150.0)
    shown.values["V1.Diagnostics.Late"] = Read(7)
    async with asked(browser, shown) as (page, keys, _):
        await keys.press("4")
        await page.locator("p", has_text="U 80 % at Δp 150 bar").wait_for()
        await page.locator("li[data-done=false]", has_text="7 signals or samples").wait_for()


async def test_what_were_the_pressures_and_the_temperature_when_the_alarm_came(browser):
    shown = plant()
    async with asked(browser, shown) as (page, keys, _):
        await keys.press("a")
        await keys.open(page.locator("a", has_text="Trend at that time"))
        (frozen,) = shown.alarms
        step = 5 * S  # of a span of 37.5 minutes
        wanted = {f"{(frozen.t // step + k) % 100:.1f}" for k in (-1, 0, 1)}
        when = page.locator("h2", has_text=re.compile("^At [0-9]"))
        await when.wait_for()
        row = page.locator(".readout tr", has_text="p₁")
        await row.locator("td.value", has_text=re.compile(r"\d")).wait_for()
        assert await row.locator("td.value").inner_text() in wanted
        before = await when.inner_text()
        await keys.press("Shift+ArrowRight")
        assert await when.inner_text() != before


async def test_how_often_was_p2_frozen_in_the_last_month_and_for_how_long(browser):
    shown = plant()
    (frozen,) = shown.alarms
    ended = [
        replace(frozen, t=frozen.t - day * 86_400 * S + 60 * S, active=False, event=b"e%d" % day)
        for day in (1, 2)
    ]
    began = [replace(one, t=one.t - 60 * S, active=True, event=one.event + b"b") for one in ended]
    other = replace(frozen, name="Changed", event=b"c", text="The flow changed by -4.1 l/min.")
    shown.past = [*shown.alarms, *began, *ended, other]
    async with asked(browser, shown) as (page, keys, _):
        await keys.press("a")
        await keys.open(page.get_by_role("button", name="Past"))
        await page.keyboard.press("/")
        await keys.type("p2")
        await page.locator(".alarm-side p", has_text="3 times in the last 30 days").wait_for()
        told = await page.locator(".alarm-side p").inner_text()
        assert "active for 27 min in all" in told  # 25 until now, and a minute on two days


async def test_what_does_the_service_suspect_and_how_sure_is_it(browser):
    shown = plant()
    shown.values["V1.Diagnostics.Findings"] = Read(["The meter's zero is off by 1.2 l/min."])
    shown.values["V1.Diagnostics.FindingProbabilities"] = Read([0.83])
    async with asked(browser, shown) as (page, keys, _):
        await keys.press("3")
        await keys.press("1")
        said = page.locator(".facts dd", has_text="83 %: The meter's zero is off by 1.2 l/min.")
        await said.wait_for()


async def test_what_did_operators_do(browser):
    shown = plant()
    async with asked(browser, shown) as (page, keys, observer):
        observer.time_line.add(
            time.time_ns(), "V1", "action", Severity.NOTE, "operator: Acknowledge of Changed."
        )
        await keys.press("5")
        await page.locator("li[data-kind=action]", has_text="operator: Acknowledge").wait_for()
        await page.get_by_label("Kind").focus()
        await keys.type("action")
        await page.locator("li[data-kind=status]").first.wait_for(state="hidden")
        assert set(await page.locator(".events li").evaluate_all(_KINDS)) == {"action"}


async def test_are_samples_lost_or_rejected_and_why(browser):
    shown = plant()
    shown.values["V1.Diagnostics.Late"] = Read(7)
    async with asked(browser, shown) as (page, keys, _):
        await keys.press("4")
        row = page.locator("tr", has_text="signals too late")
        await row.locator("td", has_text="7").wait_for()


async def test_which_valve_follows_worst(browser):
    shown = plant()
    shown.values["Boom.AT.Frame"] = Read(
        [1.0, 10.0, 0.1, 7.25, 0.3, 1.0, 0.0, 1.5, 30.0, 0.0, 1, 1, 1]
    )
    async with asked(browser, shown) as (page, keys, _):
        await keys.press("3")
        await keys.open(page.locator("th button", has_text="RMSE"))
        first = page.locator(".rows tbody tr:has(a)").first
        await first.locator("a", has_text="Boom.AT").wait_for()
        assert "7.25" in await first.inner_text()


async def test_how_did_it_run_a_day_before(browser):
    async with asked(browser, plant()) as (page, keys, _):
        await keys.press("t")
        await page.get_by_label("Compare with time").focus()
        await keys.type("a day")
        await page.locator("main[data-compared=before]").wait_for()
        assert "before=86400" in page.url
        assert "a day before" in await page.locator(".lane .legend").first.inner_text()


async def test_is_the_service_itself_in_trouble(browser):
    shown = plant()
    load = Alarm(
        source="Service",
        name="Load",
        event=b"l",
        text=f"The service works 97 %, since {SINCE} UTC.",
    )
    shown.alarms.append(load)
    async with asked(browser, shown) as (page, keys, _):
        await keys.press("3")
        await page.locator(".service", has_text="The service itself: 1 active alarm.").wait_for()
        listed = page.locator(".needs li", has_text="Service")
        assert "The service works 97 %" in await listed.inner_text()


async def frozen_alarm(page, keys):
    """Open the alarms by keyboard; the one of p2 is chosen."""
    await keys.press("a")
    detail = page.locator(".alarm-detail")
    await detail.locator("dd", has_text="p2 was constant").wait_for()
    return detail


async def time_of_day(page, t):
    """As the browser shows it."""
    return await page.evaluate("ms => new Date(ms).toLocaleTimeString('en-GB')", t / 1e6)
