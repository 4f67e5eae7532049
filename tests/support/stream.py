"""A server that numbers its samples, and a consumer that knows what it lost."""

import asyncio
import time
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field

import numpy as np
from asyncua import ua

from guarded_opcua import HardenedServer, add_object, add_variable
from support.plant_server import plant_settings
from support.proxy import Proxy
from valvemap.clock import SystemClock
from valvemap.opcua_client.source_settings import SourceSettings
from valvemap.opcua_source.client import OpcUaSource
from valvemap.opcua_source.source_nodes import ValveNodes
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.data_changes import DataChanges
from valvemap.runtime.supervisor import SupervisorSettings, supervise
from valvemap.vocabulary.signals import PER_VALVE
from valvemap_rig.history import Ring

RATE_HZ = 100

SIGNALS = ("U", "p1", "p2", "Q", "T", "Sequence")
NODES = ValveNodes(
    valve="V1",
    **{name: f"nsu=urn:plant;s=V1.{name}" for name in ("U", "p1", "p2", "Q", "T")},
    sequence="nsu=urn:plant;s=V1.Sequence",
)


def saw(k, valve):
    """Sample k of any valve: what tells it from others is enough."""
    return [float(k % 97 + signal) for signal in range(5)]


class NumberedServer:
    """Valves whose samples are numbered; `play` publishes them as time goes on.

    Sample k of the valve that is the n-th has the five signals ``shows(k, n)``.
    """

    def __init__(self, server, variables, shows):
        self.server = server
        self.variables = variables
        self.shows = shows
        self.written = 0
        self.sent = {}  # time and values of each sample, by number
        self.memory = None
        self.pace_ns = 0  # from sample to sample; 0: as time goes on

    @classmethod
    async def create(cls, *, remembers=0, valves=("V1",), shows=saw, clock=None, **more):
        server = await HardenedServer.create(
            plant_settings(**more),
            clock,
        )
        kinds = {"Sequence": ua.VariantType.UInt32}
        variables = []
        for name in valves:
            folder = await add_object(server, None, name)
            for signal in SIGNALS:
                kind = kinds.get(signal, ua.VariantType.Double)
                variables.append(
                    await add_variable(server, folder, f"{name}.{signal}", None, type=kind)
                )
        plant = cls(server, variables, shows)
        if remembers:
            plant.memory = Ring(variables, remembers, np.float64)
            server.add_history(variables, plant.memory)
        return plant

    @property
    def port(self):
        return int(self.server.url.split(":")[2].split("/")[0])

    def remember(self, n, t, step_ns, signals=None):
        """Have had n samples from a time on that nobody was sent, but for the last one.

        ``signals`` (n - 1, 5) are what they were.
        """
        k = np.arange(self.written, self.written + n - 1)
        if signals is None:
            signals = np.array([self.shows(number, 0) for number in k.tolist()])
        values = np.column_stack([signals, k])
        times = (t + np.arange(n) * step_ns) // 100 * 100
        self.sent.update(
            zip(k.tolist(), zip(times[:-1].tolist(), values.tolist(), strict=True), strict=True)
        )
        self.memory.keep(values, np.repeat(times[:-1, None], 6, axis=1), time.time_ns())
        self.written += n - 1
        self.publish(int(times[-1]))

    async def play(self, rate_hz):
        """Publish samples for ever; after a standstill, all that were due."""
        began, first, t0 = time.monotonic(), self.written, time.time_ns()
        while True:
            due = int((time.monotonic() - began) * rate_hz) + first
            while self.written < due:
                paced = t0 + (self.written - first) * self.pace_ns
                self.publish(paced if self.pace_ns else time.time_ns())
            await asyncio.sleep(0.01)

    def newest(self):
        """The source time of the newest sample, as OPC UA keeps it: in steps of 100 ns."""
        return self.sent[self.written - 1][0] // 100 * 100

    def sent_from(self, first, valve=0):
        """All samples of one valve from one on, as changes of the only valve there is."""
        return self.sent_between(first, self.written, valve)

    def sent_between(self, first, stop, valve=0):
        own = slice(PER_VALVE * valve, PER_VALVE * (valve + 1))
        chosen = [self.sent[k] for k in range(first, stop)]
        n = len(chosen)
        return DataChanges(
            item=np.tile(np.arange(PER_VALVE, dtype=np.int32), n),
            value=np.array([values[own] for _, values in chosen], float).ravel(),
            status=np.zeros(PER_VALVE * n, np.uint32),
            source_time=np.repeat([t // 100 * 100 for t, _ in chosen], PER_VALVE),
        )

    def publish(self, t):
        valves = range(len(self.variables) // PER_VALVE)
        values = [x for v in valves for x in (*self.shows(self.written, v), self.written)]
        self.sent[self.written] = t, values
        self.server.write(
            (variable, value, 0, t) for variable, value in zip(self.variables, values, strict=True)
        )
        if self.memory is not None:
            times = np.full((1, len(values)), t // 100 * 100)
            self.memory.keep(np.array([values]), times, time.time_ns())
        self.written += 1


@dataclass
class Collector:
    """Fulfils Consumer: what came, how it aligns, and when."""

    numbered: bool = True
    numbers: list = field(default_factory=list)
    times: list = field(default_factory=list)  # of samples
    arrived: list = field(default_factory=list)

    def __post_init__(self):
        self.align = Alignment(AlignmentSettings(), (("T",),), (self.numbered,))
        self.state = self.align.initial_state()

    async def connected(self, *, restarted_at):
        pass

    async def take(self, changes):
        number = changes.item % PER_VALVE == PER_VALVE - 1
        self.numbers += changes.value[number].astype(np.int64).tolist()
        self.state, samples = self.align.take(self.state, changes)
        self.times += samples.samples.t.tolist()
        if len(changes):
            self.arrived.append(time.monotonic())

    async def tick(self):
        pass

    async def lost(self, reason):
        pass

    @property
    def longest_wait_s(self):
        """Longest time without changes."""
        return float(np.diff(self.arrived).max())

    @property
    def counters(self):
        return {name: n for name, n in self.align.counters(self.state, 0).items() if n}


@asynccontextmanager
async def watching(
    served, *, named=False, rate_hz=RATE_HZ, supervision=None, nodes=None, **settings
):
    """A source behind a proxy, and what comes of it."""
    plant, password = served
    nodes = nodes or NODES
    stop, collector = asyncio.Event(), Collector(numbered=nodes.sequence is not None)
    playing = asyncio.create_task(plant.play(rate_hz))
    try:
        async with Proxy(plant.port) as proxy:
            settings = SourceSettings(
                f"opc.tcp://127.0.0.1:{proxy.port}/plant/",
                user="operator" if named else None,
                password=password if named else None,
                **settings,
            )
            source = OpcUaSource(settings, [nodes])
            serving = asyncio.create_task(
                supervise(
                    source, collector, SystemClock(), stop, supervision or SupervisorSettings()
                )
            )
            try:
                await until(lambda: len(collector.times) > rate_hz)
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
        while not condition():  # noqa: ASYNC110 - what comes over a socket sets no event
            await asyncio.sleep(0.02)
