"""A service that is killed and started again goes on where it was, and nothing is lost or twice."""

import asyncio
from contextlib import suppress

import numpy as np
import pytest
import pytest_asyncio
from support.stream import NODES, NumberedServer

from service.clock import SystemClock
from service.hardened import Role, UserStore
from service.identification.recursive_least_squares import RecursiveLeastSquares
from service.opcua.client import OpcUaSource, SourceSettings
from service.storage.checkpoints import CheckpointFile
from service.streaming.alignment import Alignment, AlignmentSettings
from service.streaming.identification import Identification
from service.streaming.live import LiveService, LiveSettings
from service.streaming.pipeline import ValvePlan
from service.streaming.quality_gate import PLAUSIBLE, SENSORS, QualityGate, SignalLimits
from service.streaming.supervisor import SupervisorSettings, supervise

pytestmark = pytest.mark.asyncio(loop_scope="module")

GATE = QualityGate(limits={s: SignalLimits(*PLAUSIBLE[s], spike=60.0) for s in SENSORS})


class Sink:
    """Nobody looks."""

    async def publish(self, results):
        pass

    async def show_health(self, health):
        pass


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def served(tmp_path_factory):
    users, password = UserStore.one_time("operator", Role.OPERATOR)
    plant = await NumberedServer.create(tmp_path_factory.mktemp("cache"), users=users)
    async with plant.server:
        yield plant, password


def fresh():
    plan = ValvePlan("V1", GATE, {"RLS": RecursiveLeastSquares()}, "RLS")
    return Identification([plan], Alignment(AlignmentSettings(), (True,), (True,)))


async def lived(served, store, seconds):
    """A service that is killed after some time; returns what it was when it was killed."""
    plant, password = served
    settings = SourceSettings(
        f"opc.tcp://127.0.0.1:{plant.port}/plant/", user="operator", password=password
    )
    source, clock = OpcUaSource(settings, [NODES]), SystemClock()
    live = LiveService(fresh(), source, Sink(), store, clock, LiveSettings())
    await live.start()
    running = asyncio.create_task(
        supervise(source, live, clock, asyncio.Event(), SupervisorSettings())
    )
    await asyncio.sleep(seconds)
    await live.settle()
    source.close = source.drop  # it says no good-bye
    running.cancel()
    with suppress(asyncio.CancelledError):
        await running
    return live.identification


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
            last = await lived(served, store, 3.0)
    finally:
        playing.cancel()
        with suppress(asyncio.CancelledError):
            await playing
    counters = last.counters(0)
    assert counters["aligned"] > 100 * kills
    lost = ("gaps", "missing", "late", "duplicates", "lost_by_time", "restarts")
    assert {name: counters[name] for name in lost} == dict.fromkeys(lost, 0)
    one_life = fresh()
    one_life.take(plant.sent_from(plant.written - counters["aligned"]))
    assert one_life.counters(0) == counters
    assert one_life.checkpoints() == last.checkpoints()
