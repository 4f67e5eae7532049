"""Faults, and an hour later: service, history and page are real, the hour is simulated time."""

import asyncio
import re
import time
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, replace

import numpy as np
import pytest
import pytest_asyncio

from guarded_opcua import UserStore
from support.browser import tab
from support.interoperation import identification
from support.plant import as_changes, plant
from support.results import results_settings
from support.served_page import served
from valvemap.opcua_client.results_client import ResultsClient
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_results.results_server import NAMESPACE, ResultsServer
from valvemap.runtime.past import PastKeeper
from valvemap.storage.history import HistoryFile

pytestmark = [pytest.mark.chromium, pytest.mark.asyncio(loop_scope="session")]

S = 1_000_000_000
HZ = 10
AT_ONCE_S = 10  # s of samples between two publications
LATER_S = 3_600


@dataclass(frozen=True)
class Fault:
    """When it is, s since the begin; what the page names it, and says of it."""

    during: range
    named: str
    measured: str


LOST = Fault(range(180, 240), "Sensor lost", "No usable sample for")  # Q is no number
FROZEN = Fault(range(300, 360), "Sensor frozen", "p2 was constant to the last digit")


class Hour:
    """One valve's service that has run for more than an hour when the page is opened."""

    def __init__(self, store):
        self.live = identification()
        self.past = PastKeeper(store, ["Valvistor"])
        self.began = time.time_ns() // S * S - (FROZEN.during.stop + LATER_S) * S
        self._taken = 0
        users = results_settings(users=UserStore(), none_on_loopback=True)
        history = {"past": store, "on_alarm": self.past.note_alarm}
        self.server = ResultsServer(users, self.live.descriptions(), self.live, **history)

    async def run(self, until):
        """Learn and publish the samples up to a time, UTC ns."""
        while (samples := self._next(until)) is not None:
            self.past.take(self.live.take(as_changes(samples)))
            self.live.maps.refresh()
            for results in self.live.results.of([0]):
                self.past.note(results)
                await self.server.publish(results)
        await self.past.settle()

    def _next(self, until):
        n = min(AT_ONCE_S * HZ, (until - self.began) * HZ // S - self._taken)
        if n <= 0:
            return None
        samples = plant(n, seed=self._taken, first=self._taken)
        at = self._taken / HZ
        self._taken += n
        t = self.began + (self._taken - n + np.arange(n)) * S // HZ
        p2 = np.full(n, 77.25) if int(at) in FROZEN.during else samples.p2
        Q = np.full(n, np.nan) if int(at) in LOST.during else samples.Q
        return replace(samples, t=t, p2=p2, Q=Q)


@pytest_asyncio.fixture(scope="module", loop_scope="session")
async def later(tmp_path_factory):
    """The page's URL and when the service began, UTC ns, an hour after faults; it runs on."""
    with HistoryFile(tmp_path_factory.mktemp("history") / "history.sqlite") as store:
        hour = Hour(store)
        async with hour.server:
            await hour.run(time.time_ns())

            async def run_on():
                while True:
                    await asyncio.sleep(1.0)
                    await hour.run(time.time_ns())

            running = asyncio.create_task(run_on())
            client = ResultsClient(SourceSettings(url=hour.server.url), NAMESPACE)
            async with served(client) as (_, url):
                yield url, hour.began
            running.cancel()
            with suppress(asyncio.CancelledError):
                await running


@asynccontextmanager
async def visit(browser, url):
    async with tab(browser, url) as visitor:
        await visitor.page.add_init_script("localStorage.setItem('tour', 'closed')")
        yield visitor


async def seen_in_the_trend(visitor, began, fault):
    """Wait until the trend's bands show when the fault was."""
    begun, ended = [  # s after the fault's begin
        await visitor.page.evaluate(
            "ms => ms.map(ms => new Date(ms).toLocaleTimeString('en-GB'))",
            [(began + (fault.during.start + s) * S) / 1e6 for s in between],
        )
        for between in (range(-1, 30), range(55, 75))  # from the last good sample on
    ]
    day = r"(?:[\d/]+ )?"  # where midnight lies between
    named = f"{fault.named} from {day}({'|'.join(begun)}) to {day}({'|'.join(ended)})"
    wanted = re.compile(f"{named}.*Estimate of RLS: .*ok from")
    lanes = visitor.page.locator("canvas.lanes")
    for _ in range(200):
        told = await lanes.get_attribute("aria-label")
        if wanted.search(told):
            return
        await visitor.page.wait_for_timeout(100)
    raise AssertionError(told)


@pytest.mark.parametrize("fault", [FROZEN, LOST], ids=lambda fault: fault.named)
async def test_a_fault_is_in_trend_alarm_list_and_map_an_hour_later(browser, later, fault):
    """After any navigation, a reload, and in another browser."""
    url, began = later
    assert time.time_ns() - began - fault.during.start * S >= LATER_S * S
    async with visit(browser, url) as visitor:
        page = visitor.page
        await visitor.open("trend/Valvistor?span=7200")
        await seen_in_the_trend(visitor, began, fault)
        for view in ("overview", "valve/Valvistor", "timeline"):
            await visitor.open(view)
            await page.locator("main h1").wait_for()
        await page.locator(".events li", has_text=fault.named).first.wait_for()
        await visitor.open("trend/Valvistor?span=7200")
        await page.reload()
        await seen_in_the_trend(visitor, began, fault)
        assert visitor.problems == []
    async with visit(browser, url) as visitor:
        page = visitor.page
        await visitor.open("alarms?show=past")
        await page.locator(".alarm-list button", has_text=fault.named).first.click()
        await page.locator(".measured", has_text=fault.measured).wait_for()
        await page.locator(".links a", has_text="Place in the map").click()
        place = page.locator("text=/At .* the valve worked at U .* \\(marked\\)/")
        await place.wait_for()
        await page.locator(".js-plotly-plot canvas").first.wait_for()
        await visitor.until(
            "document.querySelector('.surface').data.some(one => one.marker?.symbol === 'diamond')"
        )
        await page.go_back()
        await page.locator(".links a", has_text="Trend at that time").click()
        await seen_in_the_trend(visitor, began, fault)
        assert visitor.problems == []
