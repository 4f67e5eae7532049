"""A small plant and a service around it, without network or clock."""

from dataclasses import dataclass, field, replace

import pytest

from support.plant import START
from valvemap.clock import ManualClock
from valvemap.errors import SourceLost, SourceRejected
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.feedforward import FeedForward
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.quality_gate import QualityGate
from valvemap.pipeline.result_ports import Health
from valvemap.pipeline.source_ports import SourceCounters
from valvemap.pipeline.valve_state import ValvePlan


@pytest.fixture
def plan():
    return ValvePlan(
        name="Valvistor",
        gate=QualityGate(),
        estimators={
            "RLS": RecursiveLeastSquares(),
            "RML": MaximumLikelihood(),
            "RBF": RbfNetwork(),
        },
        inverse="RLS",
        feed_forward=FeedForward(slew_percent_per_s=50.0, has_heartbeat=True),
    )


@pytest.fixture
def fresh(plan):
    return lambda: Identification([plan], Alignment(AlignmentSettings(), optional=(("T",),)))


@pytest.fixture
def identification(fresh):
    return fresh()


@dataclass
class FakeSource:
    """Hands out what it was given; an exception in the list is raised instead."""

    script: list = field(default_factory=list)
    connects: list = field(default_factory=list)
    written: list = field(default_factory=list)
    heartbeats: list = field(default_factory=list)
    refuses: bool = False
    closed: int = 0
    dropped: int = 0
    is_held: bool = False
    counters: SourceCounters = field(default_factory=SourceCounters)
    started: int = 0
    clock_offset_s: float = 0.0
    states: tuple = ()
    remarks: dict = field(default_factory=dict)

    async def connect(self):
        if self.connects:
            error = self.connects.pop(0)
            if error is not None:
                raise error

    async def receive(self):
        if not self.script:
            raise SourceLost("the script is at its end")
        step = self.script.pop(0)
        if isinstance(step, Exception):
            raise step
        return step

    async def write_required_U(self, valve, U):
        if self.refuses:
            raise SourceRejected("not now")
        self.written.append((valve, U))

    async def write_heartbeat(self, valve, count):
        self.heartbeats.append((valve, count))

    mark = None

    def hold_back(self):
        pass

    def commit(self, mark):
        pass

    def resume_at(self, position):
        return True

    async def drop(self):
        self.dropped += 1

    async def close(self):
        self.closed += 1


@dataclass
class FakeSink:
    published: list = field(default_factory=list)
    doubted: list = field(default_factory=list)
    health: Health | None = None

    async def publish(self, results):
        self.published += [results.one(m) for m in range(len(results.valves))]

    async def doubt(self, valves):
        self.doubted += valves.tolist()

    async def show_health(self, health):
        self.health = health


@dataclass
class FakeStore:
    kept: list = field(default_factory=list)
    size: int = 0
    damaged: tuple = ()
    aside: list = field(default_factory=list)

    def put_aside(self, aside, moved):
        self.aside += aside
        gone = {(one.valve, one.estimator) for one, _ in aside} | moved.keys()
        named = [(one, (one.valve, one.estimator)) for one in self.kept]
        new = [(one, moved[name]) for one, name in named if name in moved]
        self.kept = [one for one, name in named if name not in gone]
        self.kept += [replace(one, valve=name[0], estimator=name[1]) for one, name in new]

    def save(self, checkpoints):
        rows = {(one.valve, one.estimator): one for one in (*self.kept, *checkpoints)}
        self.kept = list(rows.values())

    def load(self, _together=()):
        return self.kept


@pytest.fixture
def clock():
    return ManualClock(START)


@pytest.fixture
def sink():
    return FakeSink()


@pytest.fixture
def store():
    return FakeStore()


@pytest.fixture
def source():
    return FakeSource()
