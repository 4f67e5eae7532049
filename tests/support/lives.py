"""Lives of a service that ends without a good-bye."""

import asyncio
from contextlib import suppress

from support.stream import NODES, until
from valvemap.clock import SystemClock
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_source.client import OpcUaSource
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.quality_gate import QualityGate, SignalLimits
from valvemap.pipeline.valve_state import ValvePlan
from valvemap.runtime.live import LiveService
from valvemap.runtime.live_settings import LiveSettings
from valvemap.runtime.sources import Part, Sources, supervise_all
from valvemap.runtime.supervisor import SupervisorSettings
from valvemap.vocabulary.signals import SENSORS

GATE = QualityGate(limits={s: SignalLimits(*s.plausible, spike=60.0) for s in SENSORS})


class Sink:
    """Nobody looks."""

    async def publish(self, results):
        pass

    async def doubt(self, valves):
        pass

    async def show_health(self, health):
        pass


def fresh():
    plan = ValvePlan("V1", GATE, {"RLS": RecursiveLeastSquares()}, "RLS")
    return Identification([plan], Alignment(AlignmentSettings(), (("T",),), (True,)))


async def lived(served, store, seconds, through=0):
    """A service that is killed after some time, and not before it took the sample of ``through``.

    Returns what it was when it was killed.
    """
    plant, password = served
    settings = SourceSettings(
        f"opc.tcp://127.0.0.1:{plant.port}/plant/", user="operator", password=password
    )
    source, clock = OpcUaSource(settings, [NODES]), SystemClock()
    sources = Sources([Part(None, source, (0,))])
    live = LiveService(fresh(), sources, Sink(), store, clock, LiveSettings())
    await live.start()
    running = asyncio.create_task(
        supervise_all(sources, live, clock, asyncio.Event(), SupervisorSettings())
    )
    await asyncio.sleep(seconds)
    await until(lambda: live.identification.results.one(0).estimators["RLS"].t >= through)
    await live.keeper.settle()
    source.close = source.drop  # it says no good-bye
    running.cancel()
    with suppress(asyncio.CancelledError):
        await running
    return live.identification
