"""Sources that can less than ours: each works, nothing comes twice, what is lost is counted."""

import asyncio
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from itertools import repeat

import numpy as np
import pytest
from asyncua import ua

from guarded_opcua import Limits, Role, UserStore
from support.lives import fresh, lived
from support.stream import NODES, NumberedServer, until, watching
from support.users import CHEAP
from valvemap.runtime.supervisor import SupervisorSettings
from valvemap.storage.checkpoints import CheckpointFile

pytestmark = pytest.mark.waits

Ids = ua.ObjectIds
TRANSFER = Ids.TransferSubscriptionsRequest_Encoding_DefaultBinary
REPUBLISH = Ids.RepublishRequest_Encoding_DefaultBinary
HISTORY = Ids.HistoryReadRequest_Encoding_DefaultBinary
AT_ONCE = SupervisorSettings(pauses=lambda: repeat(0.1))
STEP_NS = 10_000_000

LESSER = {
    "no TransferSubscriptions": ((TRANSFER,), Limits()),
    "no Republish": ((REPUBLISH,), Limits()),
    "neither": ((TRANSFER, REPUBLISH), Limits()),
    "keeps two messages": ((), Limits(unacknowledged_messages=2)),
    "forgets at once": ((), Limits(longest_lifetime_s=1.0, lifetime_count=20, keep_alive_count=5)),
}


@asynccontextmanager
async def lesser(without=(), limits=None, remembers=0):
    """A plant whose server does not do some services."""
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    made = await NumberedServer.create(users=users, limits=limits or Limits(), remembers=remembers)
    for service in without:
        del made.server._services._handlers[service]
    async with made.server:
        yield made, password


def missing_of(numbers):
    return numbers[-1] - numbers[0] + 1 - len(numbers)


@pytest.mark.parametrize("remembers", [0, 10_000], ids=["no history", "history"])
@pytest.mark.parametrize(("without", "limits"), LESSER.values(), ids=LESSER)
async def test_a_cut_costs_what_is_counted_and_with_history_nothing(without, limits, remembers):
    async with (
        lesser(without, limits, remembers) as served,
        watching(served, named=True, supervision=AT_ONCE) as (proxy, _, collector),
    ):
        await proxy.cut_for(1.6)
        target = served[0].written + 150  # what waits behind a hole has left by then
        await until(lambda: collector.numbers[-1] >= target)
        await until(lambda: collector.counters.get("gaps", 0) == missing_of(collector.numbers))
        numbers, lost = collector.numbers, missing_of(collector.numbers)
        assert numbers == sorted(set(numbers))
        assert collector.counters.keys() <= {"aligned", "gaps"}
        assert lost == 0 or not remembers


@pytest.mark.parametrize("remembers", [0, 10_000], ids=["no history", "history"])
@pytest.mark.parametrize(
    ("without", "limits"),
    [LESSER["no TransferSubscriptions"], LESSER["no Republish"], LESSER["keeps two messages"]],
    ids=["no TransferSubscriptions", "no Republish", "keeps two messages"],
)
async def test_a_kill_costs_what_is_counted_and_with_history_nothing(
    tmp_path, without, limits, remembers
):
    async with lesser(without, limits, remembers) as served:
        plant = served[0]
        playing = asyncio.create_task(plant.play(100))
        try:
            for _ in range(2):
                with CheckpointFile(tmp_path / "state.sqlite") as store:
                    await lived(served, store, 1.7)
            playing.cancel()
            with CheckpointFile(tmp_path / "state.sqlite") as store:
                last = await lived(served, store, 1.0, plant.newest())
        finally:
            playing.cancel()
            with suppress(asyncio.CancelledError):
                await playing
        counters = last.results.counters(0)
        first = plant.written - counters["aligned"] - counters["gaps"]
        assert first >= 0
        others = ("missing", "late", "duplicates", "restarts")
        assert {name: counters[name] for name in others} == dict.fromkeys(others, 0)
        if remembers:
            assert counters["gaps"] == 0
            one_life = fresh()
            one_life.take(plant.sent_from(first))
            assert one_life.states.checkpoints() == last.states.checkpoints()


@pytest.mark.parametrize("remembers", [0, 10_000], ids=["no history", "history"])
async def test_without_running_number_the_pace_tells_what_is_lost(remembers):
    async with lesser((TRANSFER, REPUBLISH), Limits(queue_size=30), remembers) as served:
        served[0].pace_ns = STEP_NS
        nodes = replace(NODES, sequence=None)
        async with watching(served, nodes=nodes, supervision=AT_ONCE) as (proxy, _, collector):
            await proxy.cut_for(1.6)
            heard = len(collector.times)
            await until(lambda: len(collector.times) > heard + 150)
            steps = np.diff(collector.times) // STEP_NS
            assert (steps > 0).all()  # nothing twice
            lost = int(steps.sum()) - len(steps)
            assert collector.counters.get("lost_by_time", 0) == lost
            assert (lost == 0) == bool(remembers)
