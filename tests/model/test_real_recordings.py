"""Recordings of real machines that nobody here made."""

import numpy as np
import pytest

from benchmarks import measured_data
from benchmarks.recordings import (
    COOLING_CIRCUIT,
    SETTLED,
    TRAINING,
    ahead,
    air_valve_error,
    armax,
    arx,
    cooling_circuit_regressors,
    one_step_ahead,
    r2,
    settled_r2,
)
from support.soaked import soaked
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import Adaptive, Exponential, SlidingWindow, Variable
from valvemap.model.least_squares import batch_least_squares
from valvemap.model.least_squares_of_arrays import recursive_least_squares
from valvemap.model.model_structures import FiveTerms
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.model.tensor_spline import TensorSpline
from valvemap.vocabulary.statuses import Status

elsewhere = pytest.mark.skipif(not measured_data.elsewhere_is_there(), reason=measured_data.ABSENT)


@pytest.fixture(scope="module")
def circuit():
    return measured_data.cooling_circuit()


@pytest.fixture(scope="module")
def actuator():
    return measured_data.actuator()


@pytest.fixture(scope="module")
def air_valve():
    return measured_data.air_valve()


def test_the_cooling_circuit_is_what_its_description_says(circuit):
    assert len(circuit) == 2205 * 60
    assert 8.0 < circuit.Q.min() < circuit.Q.max() < 11.0
    assert (circuit.dp > 0.0).all()


def test_one_step_ahead_with_lam_0_999_explains_0_9989_of_the_flow(circuit):
    assert one_step_ahead(circuit, Exponential(0.999)) >= 0.9989


@pytest.mark.parametrize("rule", [Variable(0.995), Adaptive(0.99), *soaked(SlidingWindow(100))])
def test_one_step_ahead_rules_that_follow_the_rig_explain_0_9994(circuit, rule):
    assert one_step_ahead(circuit, rule) >= 0.9994


def test_the_estimator_says_of_the_recording_what_the_function_says(circuit):
    rls = RecursiveLeastSquares(structure=COOLING_CIRCUIT, forgetting=Exponential(0.999))
    state, trace = rls.update(rls.initial_state(), circuit)
    result = recursive_least_squares(cooling_circuit_regressors(circuit), circuit.Q, 0.999)
    np.testing.assert_array_equal(trace.residual, result.innovations)
    np.testing.assert_array_equal(state.theta, result.theta)
    assert (trace.status[SETTLED:] == Status.OK).all()
    assert settled_r2(circuit.Q, trace.residual) >= 0.9989


def test_the_recording_in_batches_of_an_hour_gives_the_same_bits(circuit):
    rls = RecursiveLeastSquares(structure=COOLING_CIRCUIT, forgetting=Adaptive())
    whole, trace = rls.update(rls.initial_state(), circuit)
    state, residuals = rls.initial_state(), []
    for first in range(0, len(circuit), 3600):
        state, part = rls.update(state, circuit[first : first + 3600])
        residuals.append(part.residual)
    assert state.to_bytes("k") == whole.to_bytes("k")
    np.testing.assert_array_equal(np.concatenate(residuals), trace.residual)


def test_after_37_hours_theta_is_that_of_weighted_batch_least_squares(circuit):
    X = cooling_circuit_regressors(circuit)
    theta = recursive_least_squares(X, circuit.Q, 0.999).theta
    np.testing.assert_allclose(theta, batch_least_squares(X, circuit.Q, 0.999), rtol=1e-8)


def test_frozen_parameters_age_and_so_does_the_last_flow(circuit):
    # No winner is claimed: one second ahead nothing beats the flow just measured, and it knows
    # neither dp nor T.
    X = cooling_circuit_regressors(circuit)
    result = recursive_least_squares(X, circuit.Q, Exponential(0.999))
    figures = [ahead(circuit, result.theta_history, h) for h in (1, 60, 600)]
    one_step = settled_r2(circuit.Q, result.innovations)
    assert figures[0].frozen == pytest.approx(one_step, abs=1e-12)
    assert figures[0].persistence > figures[0].frozen
    assert figures[0].frozen > figures[1].frozen > figures[2].frozen > 0.9
    assert figures[0].persistence > figures[1].persistence > figures[2].persistence


@elsewhere
def test_arx_of_the_actuator_is_batch_least_squares_and_carries_over_to_the_second_half(actuator):
    model = arx(actuator, na=3, nb=2)
    y, u = actuator.y[:TRAINING], actuator.u[:TRAINING]
    X = np.column_stack([-y[2:-1], -y[1:-2], -y[:-3], u[2:-1], u[1:-2]])
    np.testing.assert_allclose(model.theta, np.linalg.lstsq(X, y[3:])[0], rtol=1e-9)
    assert model.one_step < 0.08 * actuator.y[TRAINING:].std()
    assert model.simulated < 0.65 * actuator.y[TRAINING:].std()


@elsewhere
@pytest.mark.parametrize("p0", [10.0, 100.0, 1e4])
def test_armax_of_the_actuator_predicts_the_second_half_no_worse_than_arx(actuator, p0):
    armax_1, plain = armax(actuator, 2, 1, 1, p0), arx(actuator, 2, 1)
    assert armax_1.one_step < plain.one_step
    assert armax_1.simulated < 1.01 * plain.simulated


@elsewhere
@pytest.mark.parametrize("p0", [1.0, 10.0, 100.0, 1e4])
@pytest.mark.parametrize("orders", [(2, 1, 1), (2, 2, 1), (2, 2, 2), (3, 2, 1)])
def test_armax_of_the_actuator_is_never_far_from_arx_though_it_begins_quiet(actuator, orders, p0):
    """512 samples, 20 of them of nothing: little to learn a noise model from, but no harm done."""
    noisy, plain = armax(actuator, *orders, p0), arx(actuator, *orders[:2])
    assert noisy.one_step < 1.2 * plain.one_step
    assert noisy.simulated < 1.1 * plain.simulated


@elsewhere
def test_the_air_valve_bends_where_eq_7_is_straight(air_valve):
    # dp is constant: eq. (7) is a straight line in U, and the prior keeps the spline sane in dp.
    straight = air_valve_error(air_valve, RecursiveLeastSquares(structure=FiveTerms()))
    breaks = tuple(np.linspace(0.0, 100.0, 9).tolist())
    spline = TensorSpline(U=breaks, s=(0.0, 1.0, 2.0))
    assert straight.rmse > 2.5
    assert air_valve_error(air_valve, RecursiveLeastSquares(structure=spline)).rmse < 0.75


@elsewhere
def test_auto_finds_the_air_valves_bends_by_itself(air_valve):
    assert air_valve_error(air_valve, FlowMap()).rmse < 1.0


def test_auto_keeps_its_map_of_a_plant_that_uses_one_cell_of_it(circuit):
    # Once its cell counted as an outlier: after 49,350 s the map was 0.
    estimator = FlowMap()
    _, trace = estimator.update(estimator.initial_state(), circuit[:52_000])
    assert np.abs(trace.residual[10_000:]).max() < 0.5  # l/min, of 9


def test_what_the_rig_never_did_is_not_invented(circuit):
    # One valve position alone: what U does stays unknown, whatever the estimator.
    rls = RecursiveLeastSquares(structure=FiveTerms(), forgetting=Adaptive())
    day = circuit[:3600]
    state, trace = rls.update(rls.initial_state(), day)
    assert (trace.status == Status.WARMING_UP).all()
    assert np.isfinite(trace.residual[SETTLED:]).all()
    Q, _ = rls.predict(state, np.array([50.0]), day.dp[:1], day.T[:1])
    assert np.isnan(Q).all()


def test_a_missing_hour_is_no_reason_to_lose_the_thread(circuit):
    gap = slice(40_000, 43_600)
    Q = circuit.Q.copy()
    Q[gap] = np.nan
    with_gap = Samples.of(circuit.t, circuit.U, circuit.p1, circuit.p2, Q, circuit.T)
    rls = RecursiveLeastSquares(structure=COOLING_CIRCUIT, forgetting=Exponential(0.999))
    _, trace = rls.update(rls.initial_state(), with_gap)
    assert (trace.status[gap] == Status.REJECTED).all()
    kept = np.isfinite(trace.residual)
    kept[:SETTLED] = False
    assert r2(circuit.Q[kept], trace.residual[kept]) >= 0.9988
