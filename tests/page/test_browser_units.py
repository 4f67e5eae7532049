"""Units by the user's choice: in every view and sentence, every number of a sentence."""

import json
import re
import time
from contextlib import asynccontextmanager

import pytest

from support.browser import tab
from support.readings import Read
from support.served_page import served
from support.shown_service import Alarm, ShownService
from valvemap.errors import CommandRejected

pytestmark = [pytest.mark.chromium, pytest.mark.asyncio(loop_scope="session")]

RIG = "opc.tcp://127.0.0.1:1/rig/"
US = {"pressure": "psi", "flow": "gpm", "temperature": "°F"}
SENTENCES = {  # of the service, and as they are shown; a minus is a true one
    "The flow changed by -4.1 l/min": "The flow changed by −1.08 gpm",
    "The flow changed by +4.1 l/min": "The flow changed by +1.08 gpm",
    "From 20 to 120 bar the flow changes by 3 % only.": "From 290 to 1740 psi the flow changes by "
    "3 % only.",
    "U 0 … 100 %, Δp 0 … 200 bar": "U 0 … 100 %, Δp 0 … 2900 psi",
    "map ± 0.45 l/min (wanted 0.5 l/min)": "map ± 0.119 gpm (wanted 0.132 gpm)",
    "leak 0.52 ± 0.1 (l/min)/bar too much": "leak 0.00947 ± 0.00182 gpm/psi too much",
    "Q/√dp up to 6.2 l/min/√bar": "Q/√dp up to 0.43 gpm/√psi",
    "load 10 bar/s": "load 145 psi/s",
    "oil at 40 °C": "oil at 104 °F",
    "T moved by +3 °C": "T moved by +5.4 °F",
    "oil at 38 ± 2 °C": "oil at 100 ± 3.6 °F",
    "p1 to 5 bar, in 3 to 5 s, U 30 to 60 %": "p1 to 72.5 psi, in 3 to 5 s, U 30 to 60 %",
    "an error of 1.2e+03 l/min": "an error of 317 gpm",
}
OF_SERVICE = "The meter reads -4.1 l/min at 10 to 120 bar and 40 °C."
_METRIC = re.compile(r"(?<![\w/])(l/min|bar|°C)(?!\w)")
_READ = """() => { const view = document.querySelector('main'); return [view.innerText,
    ...[...view.querySelectorAll('*')].flatMap(({ title, ariaLabel }) => [title, ariaLabel])
].join('\\n'); }"""
VIEWS = (
    *("valve/V1", "trend/V1", "map/V1", "alarms", "alarms?show=past", "overview"),
    *("commissioning/V1", "timeline", "rig/V1", "axis/Press", "line/Boom.LineA", "valve/Boom.PA"),
)


def plant():
    alarm = Alarm(text=OF_SERVICE, t=time.time_ns() - 60 * 10**9)
    shown = ShownService(
        names=("V1", "Boom.PA", "Boom.AT"),
        lines=("Boom.LineA",),
        axes=("Press",),
        more=("Commission",),
        alarms=[alarm],
        past=[alarm],
    )
    said, several = Read(OF_SERVICE), Read([OF_SERVICE])
    for name in ("RLS.Structure", "Diagnostics.LastAction", "RecommendedReason", "Dynamics.Reason"):
        shown.values[f"V1.{name}"] = said
    for name in ("Diagnostics.Findings", "Diagnostics.Waiting", "Diagnostics.Timing"):
        shown.values[f"V1.{name}"] = several
    shown.values["V1.Diagnostics.FindingProbabilities"] = Read([0.83])
    shown.values["V1.Commission.Progress"] = said
    shown.values["V1.Baseline.Version"] = Read("7")
    shown.values["Press.Reason"] = said
    return shown


@asynccontextmanager
async def visit(browser, shown, units):
    async with served(shown, RIG) as (page, url), tab(browser, url, "any") as visitor:
        kept = json.dumps(json.dumps(units))
        await visitor.page.add_init_script(
            f"localStorage.setItem('tour', 'closed'); localStorage.setItem('units', {kept})"
        )
        yield visitor, page
        assert visitor.problems == []


@pytest.mark.parametrize("text", SENTENCES)
async def test_every_number_of_a_sentence_is_in_the_units_in_use(browser, text):
    told = "text => import('./js/units.js').then(({ inUnits }) => inUnits(text))"
    for units, expected in ((US, SENTENCES[text]), ({}, text)):
        async with visit(browser, ShownService(), units) as (visitor, _):
            await visitor.open("overview")
            assert await visitor.page.evaluate(told, text) == expected.replace(" -", " −")


async def test_no_view_says_anything_in_other_units(browser):
    async with visit(browser, plant(), US) as (visitor, page):
        await visitor.open("overview")
        await visitor.log_in()
        page.observer.time_line.add(time.time_ns(), "V1", "action", 1, f"operator: {OF_SERVICE}")
        for view in VIEWS:
            await visitor.open(view)
            await visitor.page.locator("main h1").wait_for()
            await visitor.page.wait_for_timeout(2_500)
            seen = await visitor.page.evaluate(_READ)
            metric = [line for line in seen.splitlines() if _METRIC.search(line)]
            assert metric == [], view


async def test_a_refusal_stays_to_be_read_in_the_units_in_use(browser):
    shown = ShownService()

    async def refuse(*_):
        raise CommandRejected(OF_SERVICE)

    shown.write = refuse
    async with visit(browser, shown, US) as (visitor, _):
        await visitor.open("map/V1")
        await visitor.log_in()
        await visitor.page.get_by_role("button", name="Write as FlowDemand").click()
        told = visitor.page.locator("[role=status]", has_text="−1.08 gpm at 145 to 1740 psi")
        await told.wait_for()
        await visitor.page.wait_for_timeout(1_500)  # new values arrive
        assert await told.is_visible()
        assert all("409" in problem for problem in visitor.problems)
        visitor.problems.clear()


async def test_the_size_of_a_fault_is_in_the_units_in_use(browser):
    shown = ShownService()
    async with visit(browser, shown, US) as (visitor, _):
        page = visitor.page
        await visitor.open("rig/V1")
        await visitor.log_in()
        await page.locator("select[name=kind]").select_option("offset.p1")
        assert "Size in psi" in await page.locator(".pair").inner_text()
        assert await page.locator("input[name=size]").input_value() == "72.5"
        await page.get_by_role("button", name="Inject").click()
        await page.locator("[role=status]", has_text="Offset of p1, 72.5 psi for 10 s").wait_for()
        (injected,) = [one for one in shown.calls if one[1] == "InjectFault"]
        assert pytest.approx(5.0, abs=0.01) in [value for row in injected[2] for value in row]
