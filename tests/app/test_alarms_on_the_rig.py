"""What is done to the rig raises the alarm that names it; work without a fault raises none."""

import copy

import numpy as np
import pytest

from valvemap.app.build import build_plans
from valvemap.config.models import Config
from valvemap.model.samples import Samples, Segments
from valvemap.pipeline.alarm_words import Cause
from valvemap.pipeline.fleet import Fleet
from valvemap_rig.excitation import Cycle, External, Scattered
from valvemap_rig.faults import commanded_fault
from valvemap_rig.scenario import Scenario, ValveBench
from valvemap_rig.sensors import Sensor, Sensors
from valvemap_rig.simulation import Commands, advance, initial
from valvemap_rig.valvistor import Valvistor

HZ = 100
START = 1_800_000_000_000_000_000
NAME = "Other"
BENCH = ValveBench(
    name=NAME, valve=Valvistor(K_MP=5.0, spring_rate_N_mm=8.0, dead_band_percent=4.0)
)
CONFIG = Config(valves=[{"name": NAME, "estimators": [{"kind": "Auto"}]}])


class Line:
    """The rig, and behind it what the service makes of its samples."""

    def __init__(self, scenario):
        self.scenario = scenario
        self.rig = initial(scenario, START)
        (plan,) = build_plans(CONFIG)
        self.fleet = Fleet(plan, 1)
        self.came = {}

    def run(self, seconds, commands=None, block=HZ):
        for _ in range(round(seconds * HZ / block)):
            self.rig, one = advance(self.scenario, self.rig, block, commands)
            commands = None
            self.take(one.valves[NAME])
        return one.valves[NAME]

    def take(self, block):
        worst = np.maximum.reduce(list(block.status.values())) >> 30
        sent = np.logical_and.reduce(list(block.present.values()))
        columns = block.t, block.U, block.p1, block.p2, block.Q, block.T
        samples = Samples.of(*columns, np.minimum(worst, 2))[sent]
        if len(samples):
            self.fleet.take(samples, Segments.one(len(samples)))
        for report in self.fleet.alarms.reports(0):
            if report.active and report.name not in self.came:
                self.came[report.name] = report.text


def learnt(excitation, seconds):
    line = Line(Scenario(seed=11, valves=(BENCH,), excitation=excitation))
    line.run(seconds)
    assert line.came == {}
    return line


@pytest.fixture(scope="module")
def at_a_machine():
    return learnt(Cycle(), 300.0)


@pytest.fixture(scope="module")
def on_a_bench():
    return learnt(Scattered(hold_s=0.02), 150.0)


FAULTS = [
    ("damage", -12.0, 0.0, "Changed", Cause.EDGE.words),
    ("edge", 0.4, 0.0, "Changed", Cause.EDGE.words),
    ("offset", 5.0, 0.0, "Changed", Cause.METER.words),
    ("offset.p1", 8.0, 0.0, "Changed", Cause.SIGNAL.words),
    ("lag", 0.25, 0.0, "LagFound", "A signal lags by 0.2"),
    ("frozen", 1.0, 0.0, "SensorFrozen", "Q was constant"),
    ("frozen.p2", 1.0, 0.0, "SensorFrozen", "p2 was constant"),
    ("bad_quality", 1.0, 0.0, "SensorLost", "No usable sample"),
]
WITHIN_S = {"LagFound": 100}  # s; a lag must explain some thousand samples better than no lag


@pytest.mark.parametrize(("kind", "size", "duration_s", "alarm", "words"), FAULTS)
def test_a_fault_at_a_machine_raises_the_alarm_that_names_it(
    at_a_machine, kind, size, duration_s, alarm, words
):
    check(at_a_machine, kind, size, duration_s, alarm, words)


@pytest.mark.parametrize(("kind", "size", "duration_s", "alarm", "words"), FAULTS)
def test_a_fault_on_a_bench_raises_the_alarm_that_names_it(
    on_a_bench, kind, size, duration_s, alarm, words
):
    check(on_a_bench, kind, size, duration_s, alarm, words)


def test_damage_while_the_map_is_new_raises_the_alarm_within_ten_seconds():
    line = learnt(Scattered(hold_s=0.02), 25.0)
    line.run(1.0, Commands(faults=((NAME, commanded_fault("damage", -10.0, 0.0)),)))
    line.run(9.0)
    assert Cause.EDGE.words in line.came.get("Changed", ""), line.came


def test_the_map_follows_oil_that_warms_so_no_alarm_comes(at_a_machine, on_a_bench):
    for line in (at_a_machine, on_a_bench):
        line = copy.deepcopy(line)  # noqa: PLW2901 - the fixture's stays as it is
        warms = commanded_fault("temperature_ramp", 22.0, 40.0)
        line.run(46.0, Commands(faults=((NAME, warms),)))
        assert line.came == {}


def check(line, kind, size, duration_s, alarm, words):
    line = copy.deepcopy(line)
    fault = commanded_fault(kind, size, duration_s)
    assert line.came == {}
    line.run(1.0, Commands(faults=((NAME, fault),)))
    for _ in range(WITHIN_S.get(alarm, 45)):
        line.run(1.0)
        if words in line.came.get(alarm, ""):
            break
    assert words in line.came.get(alarm, ""), line.came
    for text in line.came.values():
        assert text.partition("It may be: ")[2].count(";") <= 2


def work(seconds, seed):
    """A machine that starts and stops, in a closed loop, sometimes at the pump's limit."""
    sensors = Sensors(Q=Sensor(noise=0.4, quantum=0.01, lag_s=0.05))
    excitation = External(sweep_s=23.0, p2_low_bar=15.0, p2_high_bar=165.0)
    scenario = Scenario(seed=seed, valves=(BENCH,), excitation=excitation, sensors=sensors)
    line, rng = Line(scenario), np.random.default_rng(seed)
    U, Q, demand, until, t = 0.0, 0.0, 0.0, 0.0, 0.0
    while t < seconds:
        if t >= until:
            stops = rng.uniform() < 0.2
            demand = 0.0 if stops else float(rng.choice([20.0, 60.0, 110.0, 160.0, 260.0]))
            until = t + rng.uniform(2.0, 30.0 if stops else 8.0)
        U = float(np.clip(U + np.clip(0.04 * (demand - Q), -3.0, 3.0), 0.0, 100.0))
        block = line.run(0.1, Commands(U={NAME: U}), block=10)
        Q, t = float(block.Q[-1]), t + 0.1
    return line


def test_work_without_a_fault_raises_none():
    assert work(100.0, seed=3).came == {}


@pytest.mark.soak
@pytest.mark.timeout(7_200)
def test_a_day_of_work_without_a_fault_raises_none():
    assert work(86_400.0, seed=4).came == {}
