"""Trends: the same intervals however one pans, the past read once, and honest without a history."""

import asyncio
import math

import numpy as np
import pytest

from support.shown_service import FRAME, ShownService
from valvemap.clock import ManualClock
from valvemap.errors import SourceLost
from valvemap.page.layout import Valve
from valvemap.page.seen import Seen
from valvemap.page.trends import STEPS_MS, Trends, recorded

S = 1_000_000_000
NOW = 1_800_000_000 * S
V1 = Valve("V1", ("RLS",), FRAME)
NAMES = ("Signals.Q", "RLS.Residual")


class AtNow(ManualClock):
    def now(self):
        return NOW


def trends(shown=None, **more):
    return Trends(shown or ShownService(), AtNow(), **more)


async def test_a_trend_has_the_values_of_the_history_at_common_intervals():
    found = await trends().read(V1, NAMES, (NOW - 600 * S, NOW - 300 * S), S)
    assert (found.start, found.step, found.is_kept) == (NOW - 600 * S, S, True)
    assert [course.shape for course in found.courses] == [(3, 300)] * 2
    wanted = np.arange((NOW - 600 * S) // S, (NOW - 300 * S) // S) % 100
    assert np.array_equal(found.courses[0], [wanted] * 3)


async def test_where_some_values_are_uncertain_or_none_is_good_the_trend_says_so():
    class Doubtful(ShownService):
        async def courses(self, asked, span, every_ns):
            found = await super().courses(asked, span, every_ns)
            for course in found:
                for k, t in enumerate(course.times):
                    if t >= NOW - 400 * S:
                        course.codes[k] = 0x40A4_0000
                    if t >= NOW - 350 * S:
                        course.codes[k], course.values[k] = 0x809B_0000, math.nan
            return found

    found = await trends(Doubtful()).read(V1, NAMES, (NOW - 600 * S, NOW - 300 * S), S)
    for doubt in found.doubts:
        assert doubt.tolist() == [0] * 200 + [1] * 50 + [2] * 50


async def test_what_is_past_is_read_once_for_all_who_look_and_pan():
    shown = ShownService()
    read = trends(shown)
    await read.read(V1, NAMES, (NOW - 7200 * S, NOW - 3600 * S), 10 * S)
    asked = len(shown.history)
    await read.read(V1, NAMES, (NOW - 7000 * S, NOW - 3700 * S), 10 * S)
    assert len(shown.history) == asked


async def test_what_may_still_come_is_read_again():
    shown = ShownService()
    read = trends(shown)
    for _ in range(2):
        await read.read(V1, NAMES, (NOW - 60 * S, NOW), S)
    assert len(shown.history) >= 2 * 1
    newest = [span for _, span, _ in shown.history if span[1] > NOW - S]
    assert len(newest) == 2


async def test_nothing_is_asked_of_the_future():
    shown = ShownService()
    found = await trends(shown).read(V1, NAMES, (NOW - 60 * S, NOW + 600 * S), S)
    assert max(span[1] for _, span, _ in shown.history) <= NOW + S
    assert np.isnan(found.courses[0][0, 61:]).all()


async def test_a_long_span_is_read_one_variable_at_a_time():
    shown = ShownService()
    step = STEPS_MS[-3] * 1_000_000
    await trends(shown).read(V1, NAMES, (NOW - 30 * 86_400 * S, NOW), step)
    assert {len(asked) for asked, _, _ in shown.history} == {3}


async def test_without_a_history_the_page_shows_what_it_has_seen_and_says_since_when():
    shown = ShownService(keeps_history=False)
    read = trends(shown)
    for second in range(10):
        read.see(V1, 1, NOW + (second - 20) * S, {"Signals.Q": float(second)})
    found = await read.read(V1, NAMES, (NOW - 20 * S, NOW), S)
    assert (found.is_kept, found.since) == (False, NOW - 20 * S)
    assert found.courses[0][0, :10].tolist() == list(range(10))
    assert np.isnan(found.courses[0][0, 10:]).all()
    asked = len(shown.history)
    await read.read(V1, NAMES, (NOW - 20 * S, NOW), S)
    assert len(shown.history) == asked  # it is not asked again before a reconnect
    read.forget()
    await read.read(V1, NAMES, (NOW - 20 * S, NOW), S)
    assert len(shown.history) > asked


async def test_a_client_of_the_past_alone_connects_when_needed_and_again_after_a_loss():
    shown = ShownService(up=False)
    read = trends(shown)
    with pytest.raises(SourceLost):
        await read.read(V1, NAMES, (NOW - 60 * S, NOW), S)
    shown.up = True
    assert (await read.read(V1, NAMES, (NOW - 60 * S, NOW), S)).is_kept


async def test_one_read_at_a_time():
    running, most = 0, 0

    class Slow(ShownService):
        async def courses(self, *asked):
            nonlocal running, most
            running += 1
            most = max(most, running)
            await asyncio.sleep(0)
            running -= 1
            return await super().courses(*asked)

    read = trends(Slow())
    spans = [(NOW - k * 3600 * S, NOW - (k - 1) * 3600 * S) for k in range(1, 6)]
    await asyncio.gather(*(read.read(V1, NAMES, span, 10 * S) for span in spans))
    assert most == 1


def test_what_was_seen_is_bounded_and_the_oldest_goes_first():
    seen = Seen(("Signals.Q",), 1)
    for second in range(4_000):
        seen.add(NOW + second * S, {"Signals.Q": 1.0})
    assert seen.since == NOW + 400 * S


def test_a_thousand_valves_share_the_memory():
    many = [Seen(recorded(V1), 1_000) for _ in range(3)]
    assert sum(seen._values.nbytes for seen in many) < 3 * 10_000


def test_a_row_that_comes_twice_counts_once_and_no_number_is_none():
    seen = Seen(("Signals.Q",), 1)
    seen.add(NOW, {"Signals.Q": 1.0})
    seen.add(NOW, {"Signals.Q": 5.0})
    seen.add(NOW + S, {"Signals.Q": math.nan})
    assert seen.bucketed("Signals.Q", NOW, 2 * S, 1).ravel().tolist() == [1.0, 1.0, 1.0]


async def test_a_week_is_read_in_few_requests_and_holds_the_same_intervals():
    shown = ShownService()
    read, week = trends(shown), 7 * 86_400 * S
    found = await read.read(V1, NAMES, (NOW - week, NOW), 600 * S)
    assert len(shown.history) <= 2 * len(NAMES) + 3
    wanted = np.arange((NOW - week) // (600 * S), NOW // (600 * S)) % 100
    n = len(wanted)
    assert all(np.array_equal(course[0][:n], wanted) for course in found.courses)


async def test_a_service_that_answers_slowly_is_asked_for_little_at_once():
    class Slow(ShownService):
        async def courses(self, asked, span, every_ns):
            clock.advance(2.0)
            return await super().courses(asked, span, every_ns)

    clock, shown = AtNow(), Slow()
    await Trends(shown, clock).read(V1, NAMES, (NOW - 7 * 86_400 * S, NOW), 600 * S)
    assert all(span[1] - span[0] <= 120 * 600 * S for _, span, _ in shown.history)


async def test_a_busy_machine_is_asked_as_few_questions_for_a_week():
    class Busy(ShownService):  # a request waits for its turn, however much is asked
        async def courses(self, asked, span, every_ns):
            clock.advance(0.6)
            return await super().courses(asked, span, every_ns)

    clock, shown = AtNow(), Busy()
    names = recorded(V1)[:6]
    await Trends(shown, clock).read(V1, names, (NOW - 7 * 86_400 * S, NOW), 600 * S)
    assert len(shown.history) <= 6
