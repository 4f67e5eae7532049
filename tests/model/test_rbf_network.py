"""The paper's gradient network: no divergence, bad input, and the erratum of eq. (37)."""

from dataclasses import fields

import numpy as np
import pytest

from valvemap.model.estimator import key_of
from valvemap.model.rbf_network import RbfNetwork, RbfNetworkState
from valvemap.model.samples import Samples
from valvemap.vocabulary.statuses import Quality, Status

SETTINGS = [  # grid, eta, alpha
    ((3, 3), 0.05, 0.05),
    ((3, 3), 0.5, 0.5),
    ((5, 5), 0.3, 0.1),
    ((5, 5), 0.9, 0.9),
    ((8, 8), 0.1, 0.5),
    ((8, 8), 1.0, 0.99),
]


def flow(U, dp):
    """A valve with a dead band and a bent gain: nothing that a Gaussian contains."""
    opening = np.clip((U - 5.0) / 95.0, 0.0, None)
    return 230.0 * opening**1.2 * np.sqrt(dp / 200.0) * (1.0 + 0.1 * np.tanh((dp - 60.0) / 60.0))


def samples_of(U, dp, seed=0, sigma=0.4):
    Q = flow(U, dp) + sigma * np.random.default_rng(seed).normal(size=len(U))
    return Samples.of(t=np.arange(len(U)), U=U, p1=dp, p2=0 * dp, Q=Q)


def scattered(N=12_600, seed=1):
    rng = np.random.default_rng(seed)
    return samples_of(rng.uniform(0, 100, N), rng.uniform(0, 200, N))


def structured(levels=21, each=600):
    sweep = 100.0 - 100.0 * np.cos(2 * np.pi * np.arange(each) / each)
    return samples_of(np.repeat(np.linspace(0, 100, levels), each), np.tile(sweep, levels))


GRID_U, GRID_DP = (a.ravel() for a in np.meshgrid(np.linspace(0, 100, 41), np.linspace(0, 200, 41)))


def map_rmse(estimator, state):
    Q, _ = estimator.predict(state, GRID_U, GRID_DP, np.full(len(GRID_U), np.nan))
    return np.sqrt(np.mean((Q - flow(GRID_U, GRID_DP)) ** 2))


def equal(one, other):
    return all(np.array_equal(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))


@pytest.mark.parametrize(("grid", "eta", "alpha"), SETTINGS)
def test_no_setting_diverges_on_scattered_data(grid, eta, alpha):
    network = RbfNetwork(grid=grid, eta=eta, alpha=alpha)
    state, trace = network.update(network.initial_state(), scattered())
    assert np.isfinite(network.parameters(state)[0]).all()
    assert np.nanmax(np.abs(trace.residual)) < 500
    assert np.abs(state.w).max() < 5
    assert map_rmse(network, state) < 7


@pytest.mark.parametrize(("grid", "eta", "alpha"), SETTINGS)
def test_no_setting_diverges_on_structured_data(grid, eta, alpha):
    network = RbfNetwork(grid=grid, eta=eta, alpha=alpha)
    state, trace = network.update(network.initial_state(), structured())
    assert np.isfinite(network.parameters(state)[0]).all()
    assert np.nanmax(np.abs(trace.residual)) < 500
    assert np.abs(state.w).max() < 5


def test_one_sorted_pass_fits_the_last_level_and_forgets_the_others():
    network = RbfNetwork()
    state, trace = network.update(network.initial_state(), structured())
    assert np.sqrt(np.mean(trace.residual[-300:] ** 2)) < 6
    assert map_rmse(network, state) > 20


def gradient_step(w, c, b, x, y, eta):
    """One step of eqs. (30)-(37) by central differences of the cost (32)."""

    def cost(w, c, log_b):
        H = np.exp(-np.sum((x - c) ** 2, axis=1) / (2 * np.exp(2 * log_b)))
        return 0.5 * (y - w @ H) ** 2

    parts = [w, c, np.log(b)]
    steps = []
    for k, part in enumerate(parts):
        gradient = np.empty_like(part)
        for index in np.ndindex(part.shape):
            up, down = part.copy(), part.copy()
            up[index] += 1e-6
            down[index] -= 1e-6
            gradient[index] = (
                cost(*[up if i == k else p for i, p in enumerate(parts)])
                - cost(*[down if i == k else p for i, p in enumerate(parts)])
            ) / 2e-6
        steps.append(-eta * gradient)
    return steps


def test_a_step_goes_down_the_gradient_of_eq_32():
    network = RbfNetwork(alpha=0.0, eta=1e-4)
    state, _ = network.update(network.initial_state(), scattered(2000))
    after, _ = network.update(state, samples_of(np.array([30.0]), np.array([90.0]), sigma=0.0))
    y = flow(np.array([30.0]), np.array([90.0]))[0] / 200.0
    dw, dc, dlog_b = gradient_step(
        state.w, state.c, np.exp(state.log_b), np.array([0.3, 0.45]), y, 1e-4
    )
    np.testing.assert_allclose(after.w - state.w, dw, rtol=1e-2, atol=1e-10)
    np.testing.assert_allclose(after.c - state.c, dc, rtol=1e-2, atol=1e-10)
    np.testing.assert_allclose(after.log_b - state.log_b, dlog_b, rtol=1e-2, atol=1e-10)


@pytest.mark.parametrize(("centre_rule", "diverges"), [("printed", True), ("right", False)])
def test_eq_37_without_h_blows_up_on_scattered_data(centre_rule, diverges):
    """The paper's own loop, unbounded steps, on normalised inputs; only (37) differs."""
    samples = scattered(2000)
    x = np.stack([samples.U / 100, samples.dp / 200], axis=1)
    y = samples.Q / 200
    ends = []
    with np.errstate(all="ignore"):
        for eta, alpha in [(0.1, 0.05), (0.3, 0.1), (0.5, 0.1), (0.5, 0.5)]:
            axis = np.linspace(0, 1, 5)
            c = np.stack([a.ravel() for a in np.meshgrid(axis, axis)], axis=1)
            w, b = np.zeros(25), np.full(25, 0.25)
            dw, dc, db = np.zeros(25), np.zeros((25, 2)), np.zeros(25)
            for t in range(len(y)):
                r = x[t] - c
                square = np.sum(r * r, axis=1)
                H = np.exp(-square / (2 * b * b))
                error = y[t] - w @ H
                factor = H if centre_rule == "right" else np.ones(25)
                dc = eta * error * (w * factor / b**2)[:, None] * r + alpha * dc  # (37), (38)
                db = eta * error * w * H * square / b**3 + alpha * db  # (35), (36)
                dw = eta * error * H + alpha * dw  # (33), (34)
                c, b, w = c + dc, b + db, w + dw
            ends.append(np.abs(c).max())
    blown = ~(np.array(ends) < 10)
    assert blown.any() if diverges else not blown.any()


def test_other_batches_give_the_same_bits():
    network = RbfNetwork()
    samples = scattered(500)
    whole, trace = network.update(network.initial_state(), samples)
    state, residuals = network.initial_state(), []
    for start, end in [(0, 1), (1, 1), (1, 57), (57, 58), (58, 500)]:
        state, part = network.update(state, samples[start:end])
        residuals.append(part.residual)
    assert equal(state, whole)
    np.testing.assert_array_equal(np.concatenate(residuals), trace.residual)


def test_a_state_survives_its_bytes():
    network = RbfNetwork()
    samples = scattered(400)
    half, _ = network.update(network.initial_state(), samples[:200])
    key = key_of(network)
    resumed = RbfNetworkState.from_bytes(half.to_bytes(key), key)
    assert equal(network.update(half, samples[200:])[0], network.update(resumed, samples[200:])[0])


def test_bad_samples_leave_the_state_untouched():
    network = RbfNetwork()
    state, _ = network.update(network.initial_state(), scattered(100))
    good = {"t": [0], "U": [50], "p1": [100], "p2": [0], "Q": [60]}
    for name in ("U", "p1", "p2", "Q"):
        for value in (np.nan, np.inf, -np.inf, 1e308):
            after, trace = network.update(state, Samples.of(**{**good, name: [value]}))
            assert equal(after, state)
            assert trace.status[0] in (Status.REJECTED, Status.HELD)
    after, trace = network.update(state, Samples.of(**good, quality=[Quality.BAD]))
    assert equal(after, state)
    assert trace.status[0] == Status.REJECTED


def test_before_the_first_sample_nothing_is_predicted():
    network = RbfNetwork()
    _, trace = network.update(network.initial_state(), scattered(2))
    assert np.isnan(trace.predicted).tolist() == [True, False]
    assert np.isnan(trace.residual).tolist() == [True, False]
    assert (trace.status == Status.WARMING_UP).all()


def test_no_samples_and_a_constant_signal():
    network = RbfNetwork()
    state, trace = network.update(network.initial_state(), Samples.empty())
    assert equal(state, network.initial_state())
    assert len(trace) == 0
    one = np.ones(20_000)
    state, trace = network.update(state, samples_of(50 * one, 100 * one, sigma=0.0))
    assert abs(trace.residual[-1]) < 1e-6
    assert np.abs(state.w).max() < 2


def test_prediction_comes_with_the_running_rms_of_the_residual():
    network = RbfNetwork()
    U, dp, T = np.array([50.0, np.nan]), np.array([100.0, 100.0]), np.full(2, np.nan)
    assert np.isnan(network.predict(network.initial_state(), U, dp, T)).all()
    state, trace = network.update(network.initial_state(), scattered())
    Q, std = network.predict(state, U, dp, T)
    assert Q[0] == pytest.approx(flow(50.0, 100.0), abs=10)
    assert std[0] == pytest.approx(np.sqrt(np.mean(trace.residual[-1000:] ** 2)), rel=0.3)
    assert np.isnan(Q[1])


def test_names_go_with_parameters():
    network = RbfNetwork(grid=(2, 3))
    theta, std = network.parameters(network.initial_state())
    named = dict(zip(network.parameter_names, theta, strict=True))
    assert len(named) == 6 * 4
    assert named["c6_U"] == 100.0
    assert named["c6_dp"] == 200.0
    assert np.isnan(std).all()


def test_settings_without_meaning_are_refused_by_name():
    for setting in (
        {"grid": (1, 5)},
        {"eta": 0.0},
        {"alpha": 1.0},
        {"U_range": (1.0, 1.0)},
        {"dp_range": (0.0, np.inf)},
        {"Q_scale": 0.0},
    ):
        with pytest.raises(ValueError, match=next(iter(setting))):
            RbfNetwork(**setting)
