"""A map whose operators are other ones begins again, and keeps what they leave right."""

import math

import numpy as np
import pytest

from benchmarks import circumstances as c
from benchmarks.one_model_rows import behind
from valvemap.model import flow_map_looks
from valvemap.model.fleet import copied
from valvemap.model.flow_map import FlowMap
from valvemap.model.flow_map_looks import predict
from valvemap.model.flow_map_state import axes
from valvemap.model.flow_restart import begin_again
from valvemap.model.kernels import flow_drift, flow_fit, flow_memory, flow_play
from valvemap.model.samples import Samples

BOTH = axes((0.0, 100.0), (0.0, 200.0))
MOST_ERROR = 0.16  # l/min
FAR = np.full(3, 80.0), np.array([60.0, 100.0, 150.0]), np.full(3, 40.0)
NEAR = np.array([25.0, 30.0, 35.0]), np.full(3, 40.0), np.full(3, 40.0)


def valve(U, dp):
    return 0.12 * np.maximum(U - 5.0, 0.0) * np.sqrt(dp)


@pytest.fixture
def state():
    """A map of the whole range, whose last 15 s lie at a small opening."""
    rng = np.random.default_rng(4)
    U, dp = rng.uniform(5.0, 100.0, 6_000), rng.uniform(5.0, 190.0, 6_000)
    U[4_500:], dp[4_500:] = rng.uniform(20.0, 40.0, 1_500), rng.uniform(20.0, 60.0, 1_500)
    Q = valve(U, dp) + 0.4 * rng.standard_normal(6_000)
    t = 10_000_000 * np.arange(6_000) + 1_700_000_000_000_000_000
    samples = Samples.of(t, U, dp, 0.0 * U, Q, np.full(6_000, 40.0))
    learnt, _ = FlowMap().update(FlowMap().initial_state(), samples)
    return learnt


def again(state, share):
    """Begin again where the operators have moved the flow by a share of the noise's variance."""
    begin_again(state, BOTH, 40.0, 2_000.0, share * float(state.scalars[flow_fit.VARIANCE]))
    return predict(state, BOTH, *FAR), predict(state, BOTH, *NEAR)


def test_what_was_known_elsewhere_stays_as_far_as_it_is_right(state):
    before, restarted = predict(state, BOTH, *FAR)[1], state.counters[flow_memory.RESTARTED]
    (Q, std), _ = again(state, 0.1)
    assert (np.abs(Q - valve(*FAR[:2])) < 3.0 * std).all()
    assert (std > before).all()  # as sure as before it is not
    assert std.max() < 2.0
    assert state.counters[flow_memory.RESTARTED] == restarted


@pytest.mark.parametrize("share", [2.0, math.inf])
def test_nothing_is_kept_where_the_flow_moved_by_more_than_the_noise(state, share):
    kept = again(copied(state), 0.1)[0][1]
    (_, std), (Q, _) = again(state, share)
    assert (std > 3.0 * kept).all()
    assert pytest.approx(valve(*NEAR[:2]), abs=0.4) == Q  # the last samples are learnt again
    assert state.counters[flow_memory.RESTARTED] == state.counters[flow_memory.USED]


@pytest.mark.parametrize(
    ("kind", "stays"),
    [(flow_drift.OTHER_ZERO, True), (flow_drift.OTHER_GAIN, False), (0, False)],
)
def test_an_offset_stays_that_was_found_as_a_jump(state, kind, stays):
    state.counters[flow_memory.CHANGE_KIND] = kind
    state.x[:, :, flow_drift.ZERO] = state.now[:, 0, flow_drift.ZERO] = 0.02
    again(state, 0.1)
    assert (state.now[0, 0, flow_drift.ZERO] > 0.01) == stays


def test_a_map_behind_a_play_that_is_clearly_corrected_begins_again():
    """What was learnt behind the wrong play does not stay in it, however unsure that one was."""
    N = 1_300
    U, dp = c.cycle(6, N)
    Q = valve(behind(U, 2.0), dp) + c.white(6, N)
    t = 10_000_000 * np.arange(N) + 1_700_000_000_000_000_000
    samples = Samples.of(t, U, dp, 0.0 * U, Q, np.full(N, 40.0))
    state, _ = FlowMap().update(FlowMap().initial_state(), samples)
    state.play[flow_play.HALF], state.precision[:] = 2.0, 1e-6 * state.precision
    begin_again(state, BOTH, 40.0, 2_000.0)
    assert error_of(state) > 5.0 * MOST_ERROR
    flow_map_looks._look(state, BOTH, 40.0, 2_000.0)
    assert state.play[flow_play.HALF] == pytest.approx(1.0, abs=0.1)
    assert error_of(state) < MOST_ERROR


def error_of(state):
    U, dp = (x.ravel() for x in np.meshgrid(np.linspace(10.0, 90.0, 17), np.linspace(20.0, 180.0)))
    Q, _ = predict(state, BOTH, U, dp, np.full(len(U), 40.0))
    return np.sqrt(np.mean((Q - valve(U, dp)) ** 2))
