"""Answers that come late: after the view, the choice, the user or the server has become another."""

import asyncio
import re
import time
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from support.browser import tab
from support.processes import free_port
from support.readings import Read
from support.served_page import served
from support.shown_service import Alarm, ShownService
from valvemap.errors import SourceLost
from valvemap.page import web

pytestmark = [pytest.mark.chromium, pytest.mark.asyncio(loop_scope="session")]

S = 1_000_000_000
SCRIPTS = Path(web.STATIC) / "js"
_QUESTION = re.compile(r"\blive\.(trend|past|compare|invert|invertSpeed|tracking)\(")
_ASKED = re.compile(r"\bask(OfChosen)?\(command, user\.command\(command\)\)")
_TWICE = "button => { button.click(); button.click(); }"


class Gate:
    """Lets questions of a kind through when it is opened; counts them."""

    def __init__(self, shown, name, of=lambda *_: True):
        self._open, self.asked, real = asyncio.Event(), 0, getattr(shown, name)

        async def gated(*asked):
            if of(*asked):
                self.asked += 1
                await self._open.wait()
            return await real(*asked)

        setattr(shown, name, gated)

    def open(self):
        self._open.set()

    async def until_asked(self, count=1):
        async with asyncio.timeout(30):
            while self.asked < count:  # noqa: ASYNC110 - no event
                await asyncio.sleep(0.02)


@asynccontextmanager
async def visit(browser, shown, view, **settings):
    async with served(shown, **settings) as (page, url), tab(browser, url, "any") as visitor:
        visitor.page.on("dialog", lambda dialog: asyncio.create_task(dialog.accept()))
        await visitor.open(view)
        await visitor.page.locator("main h1").wait_for()
        yield visitor, page


def alarmed():
    now = time.time_ns()
    some = [
        Alarm(source=name, t=now - k * 60 * S, event=name.encode())
        for k, name in enumerate(("V1", "V2"), 1)
    ]
    return ShownService(names=("V1", "V2", "V3"), alarms=some, past=some)


@pytest.mark.parametrize("path", sorted(SCRIPTS.rglob("*.js")), ids=lambda path: path.name)
async def test_every_question_is_asked_so_that_a_late_answer_is_dropped(path):
    """The scripts' own code, so that a new view cannot forget it."""
    if path.name in {"live.js", "user.js"}:
        return
    for line in path.read_text(encoding="utf-8").splitlines():
        if _QUESTION.search(line):
            assert "ask(" in line or "question:" in line, line
        if "user.command(" in line and "Heartbeat" not in line:  # whose answer says nothing
            assert _ASKED.search(line), line


async def test_a_slow_answer_holds_up_no_other_view(browser):
    shown = ShownService()
    gate = Gate(shown, "courses")
    async with visit(browser, shown, "trend/V1?span=3600") as (visitor, _):
        await gate.until_asked()
        await visitor.page.keyboard.press("2")
        await visitor.page.locator(".answer .value[data-u]", has_text="30.00").wait_for()
        gate.open()
        await visitor.page.wait_for_timeout(500)
        assert visitor.page.url.endswith("#/map/V1")
        assert visitor.problems == []


async def test_a_run_that_is_started_as_its_view_is_left_gets_no_heartbeat(browser):
    shown = ShownService(more=("Commission",))
    beats = Gate(shown, "write")
    beats.open()
    start = Gate(shown, "call", lambda owner, method, _: method == "Start")
    async with visit(browser, shown, "commissioning/V1") as (visitor, _):
        await visitor.log_in()
        await visitor.page.get_by_role("button", name="Start", exact=True).click()
        await start.until_asked()
        await visitor.page.keyboard.press("3")
        await visitor.page.locator("h1", has_text="All valves").wait_for()
        start.open()
        await visitor.page.wait_for_timeout(1_500)
        calls = [method for _, method, _ in shown.calls]
        assert "Start" in calls
        assert beats.asked == 0
        assert "Heartbeat" not in calls


async def test_what_is_said_of_one_alarm_is_not_said_of_the_next(browser):
    shown = alarmed()
    gate = Gate(shown, "call", lambda owner, method, _: method == "Acknowledge")
    async with visit(browser, shown, "alarms") as (visitor, _):
        page = visitor.page
        await visitor.log_in()
        await page.locator(".alarm-list button", has_text="V1").click()
        await page.get_by_role("button", name="Acknowledge", exact=True).click()
        await gate.until_asked()
        await page.locator(".alarm-list button", has_text="V2").click()
        await page.locator(".alarm-detail h2", has_text="V2").wait_for()
        await page.locator("input[name=comment]").fill("the filter")
        gate.open()
        await page.wait_for_timeout(700)
        assert await page.locator("input[name=comment]").input_value() == "the filter"
        assert await page.locator(".alarm-detail [role=status]").inner_text() == ""


async def test_a_course_is_not_drawn_as_that_of_another_valve(browser):
    shown = alarmed()
    gate = Gate(shown, "courses", lambda asked, *_: asked[0][0].startswith("V2."))
    async with visit(browser, shown, "trend/V1?span=600") as (visitor, _):
        page = visitor.page
        other = page.get_by_label("Compare with valve")
        await page.locator("main[data-reading=false]").wait_for()
        await other.select_option("V2")
        await gate.until_asked()
        await other.select_option("V3")
        await page.evaluate("() => { window.drawn = []; }")
        await page.evaluate(
            """async () => new MutationObserver(() => drawn.push(
                document.querySelector('main').dataset.compared)).observe(
                document.querySelector('main'), { attributes: true })"""
        )
        gate.open()
        await page.locator("main[data-compared='V3']").wait_for()
        assert "V2" not in await page.evaluate("drawn")


async def test_two_clicks_are_one_command(browser):
    shown = alarmed()
    gate = Gate(shown, "call", lambda owner, method, _: method == "Acknowledge")
    async with visit(browser, shown, "alarms") as (visitor, _):
        page = visitor.page
        await visitor.log_in()
        button = page.get_by_role("button", name="Acknowledge", exact=True)
        await button.and_(page.locator(":enabled")).wait_for()
        await button.evaluate(_TWICE)
        await gate.until_asked()
        assert await button.is_disabled()
        gate.open()
        await page.locator("[role=status]", has_text="Acknowledged").wait_for()
        assert [method for _, method, _ in shown.calls].count("Acknowledge") == 1


async def test_a_server_with_other_valves_behind_the_same_address_is_shown(browser):
    port = free_port()
    async with tab(browser, f"http://127.0.0.1:{port}") as visitor:
        async with served(ShownService(names=("V1", "V2")), port=port):
            await visitor.open("overview")
            await visitor.page.locator(".rows a", has_text="V2").wait_for()
        async with served(ShownService(names=("W1", "W2")), port=port):
            await visitor.page.locator(".rows a", has_text="W2").wait_for()
            await visitor.page.keyboard.press("1")
            await visitor.page.locator("h1", has_text="W1").wait_for()


async def test_a_log_out_that_is_not_answered_is_not_shown_as_done(browser):
    shown = ShownService()
    async with visit(browser, shown, "valve/V1") as (visitor, _):
        page = visitor.page
        await visitor.log_in()
        await page.route("**/log-out", lambda route: route.abort())
        await page.locator("button.user").click()
        await page.wait_for_timeout(500)
        assert "operator" in await page.locator("button.user").inner_text()
        await page.unroute("**/log-out")
        await page.locator("button.user").click()
        await page.locator("button.user", has_text="Log in").wait_for()


async def test_a_refusal_of_the_user_before_logs_nobody_out(browser):
    shown = alarmed()
    async with visit(browser, shown, "alarms") as (visitor, _):
        page, held = visitor.page, asyncio.Event()

        async def late(route):
            await held.wait()
            await route.fulfill(status=401, json={"error": "log in first"})

        await visitor.log_in()
        button = page.get_by_role("button", name="Acknowledge", exact=True)
        await button.and_(page.locator(":enabled")).wait_for()
        await page.route("**/command", late)
        await button.click()
        await page.locator("button.user").click()
        await page.locator("button.user", has_text="Log in").wait_for()
        await visitor.log_in()
        held.set()
        await page.wait_for_timeout(500)
        assert "operator" in await page.locator("button.user").inner_text()


async def test_a_log_in_that_was_cancelled_logs_nobody_in(browser):
    shown = ShownService()
    async with visit(browser, shown, "valve/V1") as (visitor, served_page):
        page, held = visitor.page, asyncio.Event()

        async def late(route):
            await held.wait()
            await route.continue_()

        await page.route("**/log-in", late)
        await page.locator("button.user").click()
        await page.locator("dialog input[name=user]").fill("operator")
        await page.locator("dialog input[name=password]").fill("any")
        await page.keyboard.press("Enter")
        await page.keyboard.press("Enter")
        await page.locator("dialog .cancel").click()
        held.set()
        await page.wait_for_timeout(1_000)
        assert await page.locator("button.user").inner_text() == "Log in"
        assert len(served_page.log_ins) == 0


async def test_what_was_not_read_while_the_service_was_away_is_read_when_it_is_back(browser):
    shown = alarmed()
    shown.alarms, shown.values = [], {"V1.DeviceHealth": Read(0)}
    past, real = Gate(shown, "past_conditions"), shown.past_conditions
    past.open()

    async def away(*_):
        raise SourceLost("gone")

    shown.past_conditions = away
    async with visit(browser, shown, "timeline") as (visitor, _):
        page = visitor.page
        await page.locator("li", has_text="was not read").wait_for()
        shown.up = False
        await page.locator(".strip", has_text="does not answer").wait_for()
        shown.past_conditions, shown.up = real, True
        await page.locator("li", has_text="Changed raised").first.wait_for()
