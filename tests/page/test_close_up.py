"""What is shown of the valves in view: followed, played out, marked where it is lost."""

import math
from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from support.readings import Read
from support.shown_service import FRAME, ShownService
from valvemap.clock import ManualClock
from valvemap.page.close_up import CloseUp
from valvemap.page.layout import Valve
from valvemap.page.play_out import PlayOut
from valvemap.page.ports import Wanted
from valvemap.page.store import Store

VALVE = Valve("V1", ("RLS",), FRAME)


def frame(service, **changed):
    """A frame of that service, some columns changed."""
    found = service._one("V1.Frame")
    return replace(
        found, value=[changed.get(n, v) for n, v in zip(FRAME, found.value, strict=True)]
    )


class Sent(ShownService):
    """A service that sends what a test gives it."""

    def __init__(self):
        super().__init__()
        self.sent = []

    def changes(self):
        sent, self.sent = self.sent, []
        return sent


async def watching():
    client, store, clock = Sent(), Store(), ManualClock()
    close_up = CloseUp(client, store, clock)
    await close_up.watch({0: VALVE})
    return client, store, clock, close_up


async def test_a_valve_that_comes_into_view_is_there_at_once():
    client, store, _, close_up = await watching()
    assert store.get(0, "RLS.PredictedFlow").value == 10.0
    assert store.get(0, "Signals.U").value == 40.0
    assert store.get(0, "RLS.ParameterStd").value == [0.01]
    assert close_up.newest(0).value[0] > 0
    reads = client.reads
    await close_up.watch({0: VALVE})
    assert client.reads == reads


async def test_results_that_come_together_are_shown_one_by_one():
    client, store, clock, close_up = await watching()
    flows = [11.0, 12.0, 13.0, 14.0, 15.0]
    client.sent = [("V1.Frame", frame(client, **{"RLS.PredictedFlow": Q})) for Q in flows]
    shown = []
    for _ in flows:
        close_up.hear()
        close_up.play()
        shown.append(store.get(0, "RLS.PredictedFlow").value)
        clock.advance(0.1)
    assert shown == flows
    assert close_up.newest(0).value[1] == flows[-1]


async def test_a_signal_that_is_lost_is_bad_and_no_point_of_the_map():
    client, store, clock, close_up = await watching()
    client.sent = [("V1.Frame", frame(client, **{"Signals.Q": math.nan}))]
    close_up.hear()
    clock.advance(1.0)
    close_up.play()
    assert store.get(0, "Signals.Q").code >= 0x80000000
    assert store.get(0, "Signals.U").code == 0
    assert [name for _, name in close_up.due(Wanted(), thoroughly=False)] == [
        "Diagnostics.SampleAge",
        "Diagnostics.LastAction",
        "Diagnostics.Findings",
        "Diagnostics.FindingProbabilities",
    ]


async def test_counters_are_read_each_second_where_they_are_in_view_and_maps_when_first_drawn():
    _, _, _, close_up = await watching()
    map_in_view = Wanted(live={0}, maps={(0, "RLS")})
    first = {name for _, name in close_up.due(map_in_view, thoroughly=False)}
    assert {"RLS.Coverage", "Diagnostics.Late", "Inverse.FlowDemand"} <= first
    later = {name for _, name in close_up.due(map_in_view, thoroughly=False)}
    assert first - later == {"RLS.Coverage"}
    thoroughly = {name for _, name in close_up.due(Wanted(live={0}), thoroughly=True)}
    assert "Diagnostics.Late" in thoroughly
    assert "RLS.Coverage" not in thoroughly


async def test_what_is_out_of_view_is_forgotten_and_a_late_message_of_it_harmless():
    client, store, _, close_up = await watching()
    await close_up.watch({})
    client.sent = [("V1.Frame", frame(client, **{"RLS.PredictedFlow": 99.0}))]
    close_up.hear()
    close_up.play()
    assert client.followed == ()
    assert close_up.newest(0) is None
    assert store.get(0, "RLS.PredictedFlow").value == 10.0


async def test_a_bad_frame_is_shown_as_it_is():
    client, store, clock, close_up = await watching()
    client.sent = [("V1.Frame", Read(None, 0x80310000, 5))]
    close_up.hear()
    clock.advance(1.0)
    close_up.play()
    assert close_up.newest(0).code == 0x80310000
    assert store.get(0, "RLS.PredictedFlow").value == 10.0


@given(st.lists(st.integers(0, 12), min_size=1, max_size=8))
def test_everything_is_played_in_its_order_before_the_next_lot_is_through(lots):
    results, played, count = PlayOut(0.5, 0.1), [], 0
    for k, size in enumerate(lots):
        results.come(range(count, count + size), now=0.5 * k)
        count += size
        for tick in range(5):
            played += results.due(0.5 * k + 0.1 * tick)
    assert played == list(range(count))
