"""Nothing pretends: in every view, whatever is lost, old, refused or not permitted is said.

Twelve tabs show all views while a trouble begins and ends; another one opens each view meanwhile,
and loads it anew.
"""

import asyncio
import re
import time
from dataclasses import dataclass

import pytest
import pytest_asyncio

from support.browser import Visit, tab
from support.processes import free_port
from support.readings import Read
from support.served_page import served
from support.shown_service import Alarm, ShownService
from valvemap.page import observer

pytestmark = [pytest.mark.chromium, pytest.mark.asyncio(loop_scope="session")]

S = 1_000_000_000
BAD_NO_COMMUNICATION, BAD_USER_ACCESS_DENIED = 0x8031_0000, 0x801F_0000
EXTRAPOLATING = 6.0  # Status
OF_V1 = ("valve/V1", "trend/V1", "map/V1", "commissioning/V1")
OF_OTHERS = ("valve/Boom.PA", "line/Boom.LineA", "axis/Press")
OF_PLANT = ("overview", "alarms", "timeline", "rig/V1")
VIEWS = (*OF_V1, *OF_OTHERS, *OF_PLANT)
PAST = ("alarms", "timeline", "rig/V1")  # what they show was reported when it happened
RIG = "opc.tcp://127.0.0.1:1/rig/"
_SEES_MS, _STEP_MS = 30_000, 500  # a busy machine
_WRITERS = "main button[data-writes]:visible"
_SEEN = """() => { // what a person sees as good, active or explained
    const view = document.querySelector('main'), shown = (one) => one.checkVisibility();
    const WHY_NOT = /may not do this|Nothing to do|does not wait|No run|No map is approved/;
    const some = (selector) => [...view.querySelectorAll(selector)].filter(shown);
    const words = view.innerText.toLowerCase().split(/\\s+/);
    const lanes = view.querySelector('canvas.lanes')?.getAttribute('aria-label') ?? '';
    return {
        words: words.filter((word) => /^(ok|good|normal)[:,.;]?$/.test(word)),
        badges: some(".badge[data-severity='0']").map((badge) => badge.innerText)
            .filter((text) => !['service', 'state'].includes(text)),
        health: some(".health[data-severity='0']").map((one) => one.innerText),
        ticks: some("li[data-done='true']").map((one) => one.innerText),
        lanes: lanes.split('; ').filter((one) => /^\\S*.*\\b(ok|identified).* on$/.test(one)),
        active: some('button[data-writes]').filter((b) => !b.disabled).map((b) => b.innerText),
        unexplained: some('button[data-writes]').filter((b) => b.disabled && !b.title)
            .map((b) => b.innerText),
        refused: some('button[data-writes]').every((b) => WHY_NOT.test(b.title)),
        text: `${document.querySelector('.strip').innerText} ${view.innerText}`,
        stale: view.dataset.stale === 'true',
    };
}"""


def plant():
    frozen = Alarm(name="SensorFrozen", severity=700, t=time.time_ns() - 600 * S)
    return ShownService(
        names=("V1", "Boom.PA", "Boom.AT"),
        lines=("Boom.LineA",),
        axes=("Press",),
        more=("Commission",),
        alarms=[frozen],
        past=[frozen],
    )


def cut(shown):
    """The service has lost the plant's server: nothing new, and Bad."""
    shown.moving = False
    for name in (*shown.names, *shown.lines):
        shown.values[f"{name}.RLS.PredictedFlow"] = Read(None, BAD_NO_COMMUNICATION, shown.t)
    shown.values["Press.Inverse.RequiredU"] = Read(None, BAD_NO_COMMUNICATION, shown.t)


def refuse_valve(shown):
    """The service denies the page the nodes of V1."""
    shown.refused = ("V1.",)


@dataclass(frozen=True)
class Trouble:
    """What happens, what a person reads of it, in which views it is of now."""

    begin: object
    reason: str
    views: tuple[str, ...] = VIEWS
    still_written: tuple[str, ...] = ()  # views of another server, or of the service's own


_OF_SERVICE = ("alarms", "rig/V1")
TROUBLES = {
    "service stopped": Trouble(lambda s: setattr(s, "up", False), "does not answer"),
    "page refused": Trouble(lambda s: setattr(s, "rejects", True), "refuses this page"),
    "source cut": Trouble(
        cut, r"no connection|signals lost|No new sample|No samples", still_written=_OF_SERVICE
    ),
    "values old": Trouble(
        lambda s: setattr(s, "moving", False), "No new sample", still_written=_OF_SERVICE
    ),
    "valve refused": Trouble(
        refuse_valve, "does not publish|unreadable", (*OF_V1, "rig/V1"), _OF_SERVICE
    ),
}


def end(shown):
    shown.up = shown.moving = True
    shown.rejects = False
    shown.refused = ()
    shown.values.clear()


@pytest_asyncio.fixture(scope="module", loop_scope="session")
async def tabs(browser):
    """Each view in a tab of its own, and one more; an operator is logged in."""
    shown = plant()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(observer, "_REFUSED_RETRY_S", 0.5)
        async with (
            served(shown, RIG, request_burst=2_000) as (_, url),
            tab(browser, url, "any") as first,
        ):
            yield shown, (visits := await opened(first, url)), first
            assert [problem for v in (*visits.values(), first) for problem in v.problems] == []


async def opened(first, url):
    """Log in, and open each view in a tab of its own."""
    context = first.page.context
    await context.add_init_script("localStorage.setItem('tour', 'closed')")
    await first.open("overview")
    await first.log_in()
    visits = {view: Visit(await context.new_page(), url) for view in VIEWS}
    for view, visitor in visits.items():
        await visitor.open(view)
        await visitor.page.locator("main h1").wait_for()
    return visits


async def seen(visitor):
    return await visitor.page.evaluate(_SEEN)


async def missed(visitor, holds, what):
    """Look until it holds; what hinders it, else None."""
    waited = 0
    while not holds(found := await seen(visitor)):
        if waited >= _SEES_MS:
            return (
                what,
                visitor.page.url.partition("#/")[2],
                {k: v for k, v in found.items() if v},
            )
        waited += _STEP_MS
        await visitor.page.wait_for_timeout(_STEP_MS)
    return None


async def hold(looks):
    found = await asyncio.gather(*looks)
    assert [one for one in found if one] == []


def pretends_nothing(view, trouble):
    def holds(found):
        is_good = [found[what] for what in ("words", "badges", "health", "ticks", "lanes")]
        explained = re.search(trouble.reason, found["text"]) and re.search(
            "[Ss]ince", found["text"]
        )
        writes = view not in trouble.still_written and found["active"]
        return (
            (view in PAST or not any(is_good)) and bool(explained or view in trouble.still_written)
            and not writes and not found["unexplained"]
        )  # fmt: skip

    return holds


def waits_without_blame(found):
    """All cards of a view say so within a second of each other."""
    told = "Wait: compiling: 2 of 8 parts done" in found["text"]
    return told and "Check the source" not in found["text"]


def as_before(before):
    def holds(found):
        return (
            found["stale"] == before["stale"]
            and set(before["badges"]) <= set(found["badges"])
            and set(before["active"]) <= set(found["active"])
        )

    return holds


@pytest.mark.parametrize("name", TROUBLES)
async def test_no_view_pretends_and_each_recovers(tabs, name):
    shown, visits, other = tabs
    trouble = TROUBLES[name]
    before = {view: await seen(visits[view]) for view in trouble.views}
    trouble.begin(shown)
    try:
        await hold(
            missed(visits[view], pretends_nothing(view, trouble), name) for view in trouble.views
        )
        for view in trouble.views:
            await other.open(view)
            await hold([missed(other, pretends_nothing(view, trouble), "drawn meanwhile")])
            await other.page.reload()
            await hold([missed(other, pretends_nothing(view, trouble), "loaded meanwhile")])
    finally:
        end(shown)
    await hold(missed(visits[view], as_before(before[view]), "over") for view in trouble.views)


async def test_no_view_pretends_once_the_page_s_own_server_is_gone_and_each_recovers(browser):
    shown, port = plant(), free_port()
    gone = Trouble(None, "page's server does not answer")
    url = f"http://127.0.0.1:{port}"
    async with tab(browser, url, "any") as first:
        async with served(shown, RIG, port=port, request_burst=2_000):
            visits = await opened(first, url)
            await visits["map/V1"].page.locator("button[data-writes]:enabled").first.wait_for()
        await hold(missed(visits[view], pretends_nothing(view, gone), "gone") for view in VIEWS)
        async with served(shown, RIG, port=port, request_burst=2_000):
            await hold(
                missed(visits[view], lambda found: not found["stale"], "over") for view in VIEWS
            )


async def test_a_user_without_the_right_finds_no_button_active_and_reads_why(tabs):
    shown, _, other = tabs
    shown.may_write = False
    try:
        await other.page.reload()
        for view in VIEWS:
            await other.open(view)
            await hold([missed(other, lambda found: found["refused"], "no rights")])
            assert not (await seen(other))["active"], view
    finally:
        shown.may_write = True


async def test_a_valve_that_works_beyond_what_was_measured_is_not_called_ok(tabs):
    shown, visits, _ = tabs
    shown.status = EXTRAPOLATING
    try:
        await hold(
            missed(visits[view], lambda found: "extrapolating" in found["text"], "extrapolating")
            for view in ("valve/V1", "map/V1", "overview")
        )
        badge = visits["valve/V1"].page.locator("main .head .badge", has_text="extrapolating")
        await badge.wait_for()
    finally:
        shown.status = 0.0


async def test_a_service_that_still_compiles_says_to_wait_instead_of_blaming_the_source(tabs):
    shown, visits, _ = tabs
    shown.values["Service.Start.Compiled"] = Read(0.0)
    shown.values["Service.Start.Text"] = Read("compiling: 2 of 8 parts done")
    shown.moving = False
    try:
        await hold(
            missed(visits[view], waits_without_blame, "compiling")
            for view in ("valve/V1", "map/V1", "trend/V1", "commissioning/V1")
        )
        shown.values["Service.Start.Compiled"] = Read(100.0)
        for view in ("valve/V1", "map/V1"):
            says = re.compile("Check the source|See Alarms")
            await visits[view].page.locator("main", has_text=says).wait_for()
    finally:
        end(shown)
