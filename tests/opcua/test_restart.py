"""A service that is killed and started again goes on where it was, and nothing is lost or twice."""

import asyncio
from contextlib import suppress

import numpy as np
import pytest
import pytest_asyncio

from guarded_opcua import Role, UserStore
from support.lives import fresh, lived
from support.stream import NumberedServer
from support.users import CHEAP
from valvemap.storage.checkpoints import CheckpointFile

pytestmark = [pytest.mark.waits, pytest.mark.asyncio(loop_scope="module")]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def served():
    users, password = UserStore.one_time("operator", Role.OPERATOR, CHEAP)
    plant = await NumberedServer.create(users=users)
    async with plant.server:
        yield plant, password


@pytest.mark.parametrize(
    "kills", [3, pytest.param(60, marks=[pytest.mark.soak, pytest.mark.timeout(900)])]
)
async def test_kills_lose_nothing_learn_nothing_twice_and_change_no_bit(served, tmp_path, kills):
    plant, _ = served
    rng = np.random.default_rng(kills)
    plant.sent.clear()
    playing = asyncio.create_task(plant.play(100))
    try:
        for _ in range(kills):
            with CheckpointFile(tmp_path / "state.sqlite") as store:
                await lived(served, store, float(rng.uniform(1.5, 3.5)))
                assert store.damaged == []
        playing.cancel()
        with CheckpointFile(tmp_path / "state.sqlite") as store:
            last = await lived(served, store, 1.0, plant.newest())
    finally:
        playing.cancel()
        with suppress(asyncio.CancelledError):
            await playing
    counters = last.results.counters(0)
    assert counters["aligned"] > 100 * kills
    lost = ("gaps", "missing", "late", "duplicates", "lost_by_time", "restarts")
    assert {name: counters[name] for name in lost} == dict.fromkeys(lost, 0)
    one_life = fresh()
    one_life.take(plant.sent_from(plant.written - counters["aligned"]))
    assert one_life.results.counters(0) == counters
    assert one_life.states.checkpoints() == last.states.checkpoints()
