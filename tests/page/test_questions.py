"""Questions of a browser about the past: answered from the service, or refused."""

import pytest

from support.shown_service import Alarm, ShownService
from valvemap.clock import SystemClock
from valvemap.page.questions import Senseless, answer_to
from valvemap.page.settings import PageSettings
from valvemap.page.web import Page

T = 1_800_000_000_000  # ms
LONG_AGO = 1_700_000_000_000
TREND = {
    "trend": "V1",
    "names": ["Signals.Q"],
    "from": LONG_AGO,
    "to": LONG_AGO + 60_000,
    "step": 100,
}


async def observer(shown=None):
    shown = shown or ShownService()
    page = Page(shown, lambda *_: (shown, None), PageSettings(), SystemClock())
    await page.observer._discover()
    return page.observer


async def test_a_trend_is_answered_in_binary():
    found = await answer_to(await observer(), 7, TREND)
    assert isinstance(found, bytes)
    assert (found[0], found[1], int.from_bytes(found[4:8], "little")) == (4, 1, 7)


@pytest.mark.parametrize(
    "change",
    [
        {"trend": "V9"},
        {"names": []},
        {"names": ["Frame"]},
        {"names": ["V2.Signals.Q"]},
        {"names": [1]},
        {"names": ["Signals.Q"] * 17},
        {"step": 123},
        {"to": LONG_AGO},
        {"to": LONG_AGO + 86_400_000},  # too many intervals
        {"from": -5},
        {"from": 1e12},
        {"to": 10**30},
    ],
)
async def test_what_no_page_asks_is_senseless(change):
    with pytest.raises(Senseless):
        await answer_to(await observer(), 1, TREND | change)


async def test_past_alarms_are_those_of_the_span_the_newest_first():
    shown = ShownService(past=[Alarm(event=b"1"), Alarm(event=b"2", t=T * 1_000_000 + 5)])
    found = await answer_to(await observer(shown), 1, {"past": True, "from": T - 10, "to": T + 10})
    assert found.index('"event":"32"') < found.index('"event":"31"')
    assert '"kept":true' in found


async def test_without_past_alarms_the_answer_says_so():
    found = await answer_to(await observer(), 1, {"past": True, "from": T - 10, "to": T + 10})
    assert '"past":[]' in found
    assert '"kept":false' in found


async def test_a_service_that_is_gone_is_an_error_and_no_end():
    shown = ShownService()
    seeing = await observer(shown)
    shown.up = False
    assert '"error"' in await answer_to(seeing, 1, TREND)


async def test_the_difference_from_the_approved_map_is_the_service_s():
    found = await answer_to(await observer(), 1, {"compare": "V1", "estimator": "RLS"})
    assert '"largest":-2.0' in found
