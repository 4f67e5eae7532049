"""A server that numbers its samples, and a consumer that tells what it lost."""

import asyncio
import time
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field

import numpy as np
from asyncua import ua
from support.proxy import Proxy

from service.clock import SystemClock
from service.hardened import HardenedServer, ServerSettings, add_object, add_variable
from service.opcua.client import OpcUaSource, SourceSettings, ValveNodes
from service.streaming.alignment import Alignment, AlignmentSettings
from service.streaming.data_changes import SIGNALS_PER_VALVE, DataChanges
from service.streaming.supervisor import SupervisorSettings, supervise

RATE_HZ = 100

NODES = ValveNodes(
    valve="V1",
    **{name: f"nsu=urn:plant;s=V1.{name}" for name in ("U", "p1", "p2", "Q", "T")},
    sequence="nsu=urn:plant;s=V1.Sequence",
)


class NumberedServer:
    """One valve whose samples are numbered; `play` publishes them as time goes on."""

    def __init__(self, server, variables):
        self.server = server
        self.variables = variables
        self.written = 0
        self.sent = {}  # time and values of each sample, by number

    @classmethod
    async def create(cls, cache, **more):
        server = await HardenedServer.create(
            ServerSettings(
                url="opc.tcp://127.0.0.1:0/plant/",
                application_uri="urn:test:plant",
                application_name="plant",
                namespace_uri="urn:plant",
                none_on_loopback=True,
                cache=cache,
                **more,
            )
        )
        valve = await add_object(server, None, "V1")
        kinds = {"Sequence": ua.VariantType.UInt32}
        variables = [
            await add_variable(
                server, valve, f"V1.{name}", None, type=kinds.get(name, ua.VariantType.Double)
            )
            for name in ("U", "p1", "p2", "Q", "T", "Sequence")
        ]
        return cls(server, variables)

    @property
    def port(self):
        return int(self.server.url.split(":")[2].split("/")[0])

    async def play(self, rate_hz):
        """Publish samples for ever; after a standstill, all that were due."""
        began, first = time.monotonic(), self.written
        while True:
            due = int((time.monotonic() - began) * rate_hz) + first
            while self.written < due:
                self.publish(time.time_ns())
            await asyncio.sleep(0.01)

    def sent_from(self, first):
        """All samples from one on, as changes."""
        chosen = [self.sent[k] for k in range(first, self.written)]
        n = len(chosen)
        return DataChanges(
            item=np.tile(np.arange(SIGNALS_PER_VALVE, dtype=np.int32), n),
            value=np.array([values for _, values in chosen], float).ravel(),
            status=np.zeros(SIGNALS_PER_VALVE * n, np.uint32),
            source_time=np.repeat([t // 100 * 100 for t, _ in chosen], SIGNALS_PER_VALVE),
        )

    def publish(self, t):
        values = [float(self.written % 97 + k) for k in range(5)] + [self.written]
        self.sent[self.written] = t, values
        self.server.write(
            (variable, value, 0, t) for variable, value in zip(self.variables, values, strict=True)
        )
        self.written += 1


@dataclass
class Collector:
    """Fulfils Consumer: what came, how it aligns, and when."""

    numbers: list = field(default_factory=list)
    arrived: list = field(default_factory=list)

    def __post_init__(self):
        self.align = Alignment(AlignmentSettings(), (True,), (True,))
        self.state = self.align.initial_state()

    async def connected(self, source_started):
        pass

    async def take(self, changes):
        number = changes.item % SIGNALS_PER_VALVE == SIGNALS_PER_VALVE - 1
        self.numbers += changes.value[number].astype(np.int64).tolist()
        self.state, _ = self.align.take(self.state, changes)
        if number.any():
            self.arrived.append(time.monotonic())

    async def tick(self):
        pass

    async def lost(self, reason):
        pass

    @property
    def counters(self):
        return {name: n for name, n in self.align.counters(self.state, 0).items() if n}


@asynccontextmanager
async def watching(served, *, named=False, rate_hz=RATE_HZ):
    """A source behind a proxy, and what comes of it."""
    plant, password = served
    stop, collector = asyncio.Event(), Collector()
    playing = asyncio.create_task(plant.play(rate_hz))
    try:
        async with Proxy(plant.port) as proxy:
            settings = SourceSettings(
                f"opc.tcp://127.0.0.1:{proxy.port}/plant/",
                user="operator" if named else None,
                password=password if named else None,
            )
            source = OpcUaSource(settings, [NODES])
            serving = asyncio.create_task(
                supervise(source, collector, SystemClock(), stop, SupervisorSettings())
            )
            try:
                await until(lambda: len(collector.numbers) > rate_hz)
                yield proxy, source, collector
            finally:
                stop.set()
                await serving
    finally:
        playing.cancel()
        with suppress(asyncio.CancelledError):
            await playing


async def until(condition, seconds=30.0):
    async with asyncio.timeout(seconds):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.02)
