"""The required U leads by the spool's delay, of valves and axes, where that is known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from support.plant import plant
from valvemap.model.axis import AxisGeometry, AxisRegression, AxisSamples
from valvemap.model.axis_fit import AxisFit
from valvemap.model.axis_inverse import axis_table, invert
from valvemap.model.dynamics import Quantity
from valvemap.pipeline.alignment import Alignment, AlignmentSettings
from valvemap.pipeline.axes import Axis
from valvemap.pipeline.axis_plan import AxisPlan
from valvemap.pipeline.dynamics_results import NOTHING_YET, DynamicsResults
from valvemap.pipeline.feedforward import FeedForward, FeedForwardState, decide, written
from valvemap.pipeline.identification import Identification
from valvemap.pipeline.operator_ports import Command
from valvemap.vocabulary.dynamics import DYNAMIC_QUANTITIES, DynamicsStatus
from valvemap.vocabulary.statuses import InverseStatus, Status
from valvemap_rig.directional import DirectionalValve, true_edge_flow

GEOMETRY = AxisGeometry(63, 45, 800, 1.2, 1.2)
PRESSURES = {"pA": 60.0, "pB": 70.0, "pS": 180.0, "pT": 2.0}
LEADS = FeedForward((-90.0, 90.0), 200.0, leads=True)
H = 0.01  # s; of samples and demands


class TrueFit(AxisFit):
    """A fit that knows the truth, up to a position."""

    def flow(self, edge, U, dp):
        return true_edge_flow(DirectionalValve(), edge, U, dp)

    def flow_std(self, edge, U, dp):
        return 0.1 + 10.0 * (np.asarray(U) > 80)


def axis(*, leads=True, spool_hz=10.0):
    """An axis that knows its edges, and a spool."""
    one = Axis(AxisPlan("Press", GEOMETRY, feed_forward=replace(LEADS, leads=leads)))
    regression = AxisRegression(GEOMETRY)
    size = len(regression.initial_state().b)
    found = TrueFit(regression, np.zeros(size), np.eye(size), 0.1, 1.0, 0.0, 0.0)
    known = SimpleNamespace(spool_hz=spool_hz)
    one.learner.known = SimpleNamespace(table=axis_table(found), map=known)
    return one


def follow(one, demands, seen=lambda _: None):
    """Give an axis samples and demands in turn; return its answers."""
    answers = []
    for k, v in enumerate(demands):
        t, at = [(k + 1) * 10_000_000], {name: [x] for name, x in PRESSURES.items()}
        one.take(AxisSamples.of(t, U=[0.0], x=[400.0], T=[40.0], **at))
        one.demand(float(v))
        answers.append(one.required())
        seen(one)
    return answers


def alone(one, v):
    return float(invert(one.learner.known.table, v, *PRESSURES.values(), 400.0).U[0])


def test_an_axis_asks_for_the_speed_after_the_delay_of_its_spool():
    one, ramp = axis(), 3.0 * np.arange(30)
    found = follow(one, ramp)[-1]
    delay_s = 1.6 / (2.0 * np.pi * 10.0)
    assert one.lead_s == pytest.approx(delay_s)
    assert pytest.approx(alone(one, ramp[-1] + 300.0 * delay_s)) == found.U
    assert found.lower <= found.U <= found.upper


@pytest.mark.parametrize("given", [{"leads": False}, {"spool_hz": np.inf}])
def test_without_the_setting_or_a_spool_there_is_no_lead(given):
    one, ramp = axis(**given), 3.0 * np.arange(30)
    assert pytest.approx(alone(one, ramp[-1])) == follow(one, ramp)[-1].U
    assert one.lead_s == 0.0


def test_a_speed_in_reach_keeps_its_answer_where_the_led_one_is_beyond():
    one = axis()
    ramp = np.linspace(0.0, 900.0, 120)
    led, bare = follow(one, ramp), follow(axis(leads=False), ramp)
    reached = [k for k, found in enumerate(bare) if found.status == InverseStatus.OK]
    assert all(led[k].status == InverseStatus.OK for k in reached)
    assert max(reached) < len(ramp) - 1
    assert all(abs(found.U) <= 100.0 for found in led)
    above = np.array([led[k].U for k in reached if led[k].U > 60.0])
    assert np.abs(np.diff(above)).max() < 2.0  # at the edge of what is known, the lead shrinks


def test_what_is_written_stays_within_slew_and_range_whatever_is_demanded():
    rng, one, state, U = np.random.default_rng(7), axis(), FeedForwardState(), []

    def write(one):
        nonlocal state
        now = H * len(U)
        situation = replace(one.situation(), U=0.0 if not U else U[-1])
        state, command = decide(LEADS, state, situation, now)
        state = written(state, command, now)
        U.append(state.U)

    t = H * np.arange(1_000)
    wild = 300.0 * np.sign(np.sin(9.0 * t)) + 150.0 * np.sin(3.0 * t) + rng.normal(0.0, 20.0, 1_000)
    follow(one, wild, write)
    assert np.abs(np.diff(U)).max() <= LEADS.slew_percent_per_s * H + 1e-9
    assert np.abs(U).max() <= 90.0


def test_noise_of_the_demand_does_not_shake_U_more_than_without():
    demands = 150.0 + np.random.default_rng(8).normal(0.0, 5.0, 600)
    led, bare = ([found.U for found in follow(axis(leads=x), demands)] for x in (True, False))
    assert np.std(np.diff(led)) < 1.1 * np.std(np.diff(bare))


def test_the_reason_says_by_how_much_it_leads_or_that_it_does_not():
    words = {}
    for hz in (10.0, np.inf):
        one = axis(spool_hz=hz)
        follow(one, [0.0])
        words[hz] = one.results().sentence
    assert words[10.0].endswith("RequiredU leads by 25 ms.")
    assert words[np.inf].endswith("RequiredU does not lead: no delay of the spool is identified.")


@pytest.fixture
def valve(plan):
    plan = replace(plan, feed_forward=FeedForward(leads=True))
    one = Identification([plan], Alignment(AlignmentSettings(), optional=(("T",),)))
    one.take_samples(0, plant(2_000))
    return one


def dynamics(**values):
    known = {"natural_frequency": 10.0, "damping": 0.8, "dead_time": 0.004} | values
    quantities = tuple(
        Quantity(known[row.field], 0.0, Status.OK)
        if np.isfinite(known.get(row.field, np.nan))
        else Quantity()
        for row in DYNAMIC_QUANTITIES
    )
    return DynamicsResults(DynamicsStatus.OK, "Found.", 1, quantities)


def ramped(one, slope=100.0, n=30):
    """U required of a valve after a ramp of demanded flow, and the last demand."""
    for k in range(n):
        one.take_samples(0, plant(1, seed=k, first=2_000 + k))
        Q = 30.0 + slope * H * k
        one.do(Command.of("demand", "Valvistor", Q, 100.0))
    return one.results.one(0).inverse.required_U, Q


def said(one):
    """What is said of the dynamics of a valve."""
    (results,) = one.results.of([0])
    return results.dynamics[0].sentence


def U_for(one, Q):
    return float(one.invert("Valvistor", Q, 100.0, np.nan).U[0])


def test_a_valve_asks_for_the_flow_after_the_delay_of_its_spool(valve):
    valve.note_dynamics(0, dynamics())
    U, Q = ramped(valve)
    delay_s = 0.8 / (np.pi * 10.0) + 0.004
    assert pytest.approx(U_for(valve, Q + 100.0 * delay_s), abs=1e-6) == U
    assert said(valve) == "Found. RequiredU leads by 29 ms."


@pytest.mark.parametrize(
    "found", [NOTHING_YET, dynamics(natural_frequency=np.nan), dynamics(damping=np.nan)]
)
def test_dynamics_that_are_not_determined_give_no_lead(valve, found):
    valve.note_dynamics(0, found)
    U, Q = ramped(valve)
    assert pytest.approx(U_for(valve, Q), abs=1e-9) == U
    assert "RequiredU does not lead" in said(valve)


def test_a_valve_that_is_not_to_lead_does_not(identification):
    identification.take_samples(0, plant(2_000))
    identification.note_dynamics(0, dynamics())
    U, Q = ramped(identification)
    assert pytest.approx(U_for(identification, Q), abs=1e-9) == U
    assert said(identification) == "Found."
