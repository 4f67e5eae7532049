"""The page's memory in a browser: trends, alarms, units, large screens."""

import math
import re
import time
from dataclasses import replace

import pytest

from support.page_visits import SIZES, alarmed, visit
from support.shown_service import Alarm, ShownService
from valvemap.vocabulary.statuses import InverseStatus, Status

pytestmark = [pytest.mark.chromium, pytest.mark.asyncio(loop_scope="session")]

S = 1_000_000_000
_PLANT = tuple(f"V{k}" for k in range(1, 13))
_FILLED = (
    *("valve/V1", "map/V1", "alarms", "overview", "trend/V1", "rig/V1"),
    "line/Boom.LineA",
)
_USED = """() => { // share of the height of each column that texts, charts and fields take
    const margin = 16, [view] = document.querySelectorAll('main > :last-child');
    const columns = new Map();
    for (const one of view.children) { // on a tablet, all are one column
        if (!one.offsetParent) continue;
        const { left } = one.getBoundingClientRect();
        columns.set(left, [...(columns.get(left) ?? []), one]);
    }
    return [...columns.values()].map((parts) => {
        const found = [[0, parts[0].getBoundingClientRect().top]], range = document.createRange();
        const add = ({ top, bottom }) => found.push([top - margin, bottom + margin]);
        for (const part of parts) {
            const walk = document.createTreeWalker(part, NodeFilter.SHOW_TEXT);
            while (walk.nextNode()) {
                if (!walk.currentNode.data.trim()) continue;
                range.selectNodeContents(walk.currentNode);
                add(range.getBoundingClientRect());
            }
            for (const one of part.querySelectorAll('canvas, input, button')) {
                if (one.offsetParent) add(one.getBoundingClientRect());
            }
        }
        let used = 0, end = 0;
        for (const [top, bottom] of found.sort((a, b) => a[0] - b[0])) {
            used += Math.max(Math.min(bottom, innerHeight) - Math.max(top, end), 0);
            end = Math.max(end, Math.min(bottom, innerHeight));
        }
        return used / innerHeight;
    });
}"""


NO_DATA = 0x809B_0000


async def test_a_trend_is_there_after_a_change_of_view_a_reload_and_in_another_browser(browser):
    shown, _ = alarmed()
    async with visit(browser, shown) as (visitor, _):
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


async def test_the_state_alarms_and_silences_are_bands_over_the_trend(browser):
    shown, frozen = alarmed()
    silent = time.time_ns() - 300 * S, time.time_ns() - 200 * S
    whole = shown.courses

    async def with_a_gap(asked, span, every_ns):
        found = await whole(asked, span, every_ns)
        for course in found:
            for k, t in enumerate(course.times):
                if silent[0] <= t < silent[1]:
                    course.values[k] = math.nan
        return found

    shown.courses = with_a_gap
    async with visit(browser, shown) as (visitor, _):
        await visitor.open("trend/V1?span=600")
        lanes = visitor.page.locator("canvas.lanes")
        for said in ("failure from", "no samples from", "Sensor frozen from"):
            await lanes.and_(visitor.page.locator(f"[aria-label*='{said}']")).wait_for()
        begun = await visitor.page.evaluate(
            "ms => new Date(ms).toLocaleTimeString('en-GB')", frozen.t / 1e6
        )
        told = await lanes.get_attribute("aria-label")
        assert re.search(rf"Sensor frozen from (?:[\d/]+ )?{begun} on", told)


async def test_an_end_that_is_dated_before_its_begin_leaves_no_alarm_active(browser):
    """As late samples do: the alarm is raised by the clock, and cleared by the time of a sample."""
    shown, frozen = alarmed()
    ended = replace(frozen, t=frozen.t - 3 * S, active=False, event=b"2")
    shown.past, shown.alarms = [frozen, ended], [frozen, ended]
    async with visit(browser, shown) as (visitor, _):
        page = visitor.page
        await visitor.open("trend/V1?span=3600")
        lanes = page.locator("canvas.lanes[aria-label*='Sensor frozen from']")
        await lanes.wait_for()
        await page.wait_for_timeout(500)
        told = [
            one
            for one in (await lanes.get_attribute("aria-label")).split("; ")
            if "Sensor frozen" in one
        ]
        assert told
        assert not [one for one in told if one.endswith(" on") or "frozen to" in one]
        await visitor.open("alarms?show=past")
        await page.locator(".alarm-list button", has_text="Sensor frozen").first.wait_for()
        assert await page.locator(".alarm-list .badge", has_text="active").count() == 0


async def test_when_the_estimate_was_uncertain_is_a_band_over_the_trend_from_the_history(browser):
    shown, _ = alarmed()
    doubtful = time.time_ns() - 300 * S, time.time_ns() - 200 * S
    whole = shown.courses

    async def with_a_doubt(asked, span, every_ns):
        found = []
        for (id_, _), course in zip(asked, await whole(asked, span, every_ns), strict=True):
            is_of_signal = ".Signals." in id_
            are = [doubtful[0] <= t < doubtful[1] and not is_of_signal for t in course.times]
            values = [math.nan if is_ else v for is_, v in zip(are, course.values, strict=True)]
            codes = [NO_DATA if is_ else 0 for is_ in are]
            found.append(replace(course, values=values, codes=codes))
        return found

    shown.courses = with_a_doubt
    async with visit(browser, shown) as (visitor, _):
        await visitor.open("trend/V1?span=600")
        lanes = visitor.page.locator("canvas.lanes[aria-label*='uncertain from']")
        await lanes.wait_for()
        told = (await lanes.get_attribute("aria-label")).split("Estimate of ")[1]
        assert re.fullmatch(r"\w+: ok from \S+ to \S+; uncertain from \S+ to \S+; ok from .*", told)
        assert visitor.problems == []


async def test_where_sample_and_answer_were_extrapolated_is_a_band_after_a_reload(browser):
    shown, _ = alarmed()
    beyond = time.time_ns() - 300 * S, time.time_ns() - 200 * S
    whole = shown.courses
    of_status = {
        "V1.RLS.Status": Status.EXTRAPOLATING,
        "V1.Inverse.RequiredUStatus": InverseStatus.EXTRAPOLATING,
    }

    async def beyond_the_map(asked, span, every_ns):
        found = []
        for (id_, kind), course in zip(asked, await whole(asked, span, every_ns), strict=True):
            code = of_status.get(id_)
            if code is None:
                found.append(course)
                continue
            values = []
            for t, value in zip(course.times, course.values, strict=True):
                is_ = beyond[0] <= t < beyond[1]
                is_part = t - every_ns < beyond[0] and kind == "Minimum"  # begins within it
                values.append(float(code) if is_ and not is_part else value)
            found.append(replace(course, values=values))
        return found

    shown.courses = beyond_the_map
    async with visit(browser, shown) as (visitor, _):
        await visitor.open("trend/V1?span=600")
        await visitor.page.locator("canvas.lanes[aria-label*='extrapolating']").wait_for()
        await visitor.page.reload()
        lanes = visitor.page.locator("canvas.lanes[aria-label*='extrapolating']")
        await lanes.wait_for()
        _, estimate, answer = (await lanes.get_attribute("aria-label")).split(". ")
        partly, beyond_ = r"partly extrapolating from \S+ to \S+", r"extrapolating from \S+ to \S+"
        assert re.fullmatch(f"Estimate of RLS: ok from .*; {partly}; {beyond_}", estimate)
        assert re.fullmatch(
            r"Answer to the demand: ok from .*; extrapolating from .*; ok from .*", answer
        )
        assert visitor.problems == []


async def test_what_is_extrapolated_is_grey_on_the_map_and_a_band_of_the_section(browser):
    """The shown service extrapolates beyond U = 90 %, in steps of 5 %."""
    async with visit(browser, ShownService()) as (visitor, _):
        await visitor.open("map/V1")
        page = visitor.page
        await page.locator("section", has_text="grey: extrapolated, U 93 to 100 %").last.wait_for()
        await page.locator(".js-plotly-plot canvas").first.wait_for()
        known, far, grey, U = await page.evaluate(
            """() => { const [known, far] = document.querySelector('.surface').data;
            return [...[known, far].map(({ z }) => z.map((row) => Number.isFinite(row[3]))),
                far.colorscale[0][1], known.y]; }"""
        )
        assert grey == "#c7cdd3"
        assert all(known)
        assert far == [u >= 90 for u in U]  # each place beside one that is extrapolated, too
        await page.locator("[data-colouring=status]").click()
        await visitor.until("document.querySelector('.surface').data[1].z.length === 0")
        assert visitor.problems == []


async def test_the_longest_verdict_on_an_answer_stays_within_its_card(browser):
    class Guessing(ShownService):
        async def call(self, owner, method, inputs):
            found = await super().call(owner, method, inputs)
            is_asked = method == "Invert"
            return [(*one[:3], InverseStatus.EXTRAPOLATING) for one in found] if is_asked else found

    async with visit(browser, Guessing()) as (visitor, _):
        await visitor.open("map/V1")
        verdict = visitor.page.locator(".inverse .badge", has_text="U is a guess")
        await verdict.wait_for()
        ends = "one => [one, one.closest('.card')].map(of => of.getBoundingClientRect().right)"
        own, card = await verdict.evaluate(ends)
        assert own < card


async def test_a_long_trend_follows_nothing_and_still_goes_on(browser):
    """One value a second is enough for it, which the page reads of every valve anyway."""
    shown = ShownService()
    async with visit(browser, shown) as (visitor, _):
        page = visitor.page
        await visitor.open("trend/V1?span=604800")
        await page.locator("h2", has_text="Newest").wait_for()
        samples = "import('./js/live.js').then(m => m.live.number('RLS.SampleCount'))"
        await visitor.until(f"{samples}.then(n => n > 0)")
        first = await page.evaluate(samples)
        await visitor.until(f"{samples}.then(n => n > {first})")
        assert shown.followed == ()
        await page.locator("button[data-span='600000']").click()
        while shown.followed != ("V1.Frame",):
            await page.wait_for_timeout(200)
        assert visitor.problems == []


_BEHIND = """async () => {
    const { addNewest, tabled } = await import('./js/trend_rows.js');
    const series = [['Signals.Q', 'Q', 'l/min']];
    const start = Math.floor(Date.now() / 1000) * 1000 - 60000;
    const rows = tabled(series, { start, step: 1000, courses: [Array(3).fill(Array(40).fill(5))] });
    addNewest(rows, series, [7], Date.now());
    return [rows.of[0][0].slice(-3), rows.isTorn];
}"""


async def test_no_line_is_drawn_from_a_history_that_is_behind_to_the_newest_value(browser):
    async with visit(browser, ShownService()) as (visitor, _):
        await visitor.open("overview")
        assert await visitor.page.evaluate(_BEHIND) == [[5, None, 7], True]


async def test_without_a_history_the_trend_says_so(browser):
    async with visit(browser, ShownService(keeps_history=False)) as (visitor, _):
        await visitor.open("trend/V1")
        note = visitor.page.locator("[role=status]", has_text="keeps no history")
        await note.wait_for()
        assert "since" in await note.inner_text()


async def test_an_alarm_is_acknowledged_by_who_may(browser):
    shown, _ = alarmed()
    async with visit(browser, shown) as (visitor, _):
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


_LEAVE_AS_ALARMS_COME = """async () => {
    const { live } = await import('./js/live.js');
    location.hash = '#/timeline';
    live.dispatchEvent(new Event('alarms'));
}"""


async def test_a_view_that_is_left_does_not_call_back(browser):
    """What the old view learns between the click and the new view changes no address."""
    shown, _ = alarmed()
    async with visit(browser, shown) as (visitor, _):
        await visitor.open("alarms")
        await visitor.page.locator("main h1", has_text="Alarms").wait_for()
        await visitor.page.evaluate(_LEAVE_AS_ALARMS_COME)
        await visitor.page.locator("main h1", has_text="Time line").wait_for()
        assert visitor.page.url.endswith("#/timeline")


async def test_units_are_the_same_everywhere_and_kept(browser):
    async with visit(browser, ShownService()) as (visitor, _):
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
        await page.locator(".slider", has_text="psi").first.wait_for()
        values = await page.locator(".slider input[type=number]").evaluate_all(
            "fields => fields.map(field => field.value)"
        )
        assert "1450" in values


@pytest.mark.parametrize("size", SIZES.values(), ids=SIZES)
async def test_the_height_of_a_screen_is_used(browser, size):
    now = time.time_ns()
    alarms = [Alarm(source=name, t=now - k * 60 * S) for k, name in enumerate(_PLANT)]
    shown = ShownService(names=(*_PLANT, "Boom.PA"), alarms=alarms, lines=("Boom.LineA",))
    one_column = {"rig/V1"} if size != SIZES["tablet"] else set(_FILLED)
    async with visit(browser, shown, size=size) as (visitor, _):
        for view in _FILLED:
            await visitor.open(view)
            await visitor.page.locator("main h1").wait_for()
            await visitor.page.wait_for_timeout(1_500)
            used = await visitor.page.evaluate(_USED)
            assert len(used) == (1 if view in one_column else 2), view
            print(view, size, [round(share, 2) for share in used])  # noqa: T201 - the figures
            assert min(used) >= 0.75, (view, used)


async def test_the_rig_shows_how_the_flow_went_before_it_was_opened(browser):
    shown = ShownService()
    async with visit(browser, shown) as (visitor, _):
        await visitor.open("rig/V1")
        await visitor.page.locator(".live canvas").first.wait_for()
        while not any("V1.RLS.PredictedFlow" in dict(asked) for asked, *_ in shown.history):
            await visitor.page.wait_for_timeout(50)
        assert visitor.problems == []


async def test_an_alarm_shows_the_signals_around_it_and_another_one_those_around_that(browser):
    shown, _ = alarmed()
    shown.alarms.append(Alarm(source="V2", name="Residual", t=time.time_ns() - 60 * S))
    async with visit(browser, shown, size=(1920, 1080)) as (visitor, _):
        page = visitor.page
        await visitor.open("alarms")
        for source in ("V1", "V2"):
            await page.locator(".alarm-list button", has_text=source).click()
            await page.locator(".alarm-trend canvas").first.wait_for()
            while not any(f"{source}.Signals.p2" in dict(asked) for asked, *_ in shown.history):
                await page.wait_for_timeout(50)
        assert await page.locator(".alarm-trend canvas").count() == 3
        await visitor.open("alarms?alarm=Service%2FLoad")
        assert visitor.problems == []


async def test_the_worst_valve_is_first_with_its_health_and_alarms_beside(browser):
    shown, _ = alarmed()
    async with visit(browser, shown) as (visitor, _):
        await visitor.open("overview")
        rows = visitor.page.locator(".rows tbody tr:has(a)")
        await rows.nth(0).and_(visitor.page.locator("tr", has_text="failure")).wait_for()
        assert "V1" in await rows.nth(0).inner_text()
        await visitor.page.locator(".needs a", has_text="Sensor frozen").wait_for()
