"""`Auto` on a machine's cycle: its intervals cover, a drift is followed, damage found, no more."""

import numpy as np
import pytest

from valvemap.model.flow_map import FlowMap
from valvemap.model.samples import Samples

SIGMA, FS = 0.4, 100.0


def bent(U, dp):
    u = np.clip((U - 5) / 95, 0, 1)
    return 13 * u * (1.12 - 0.12 * u) * np.sqrt(dp)


def s_shape(U, dp):
    u = U / 100
    return 13 * (3 * u**2 - 2 * u**3) * np.sqrt(dp)


def ramps_and_holds(rng, n, low, high):
    t, x = [0.0], [rng.uniform(low, high)]
    while t[-1] < n / FS:
        ramp, level = rng.uniform(0.4, 3.0), rng.uniform(low, high)
        t += [t[-1] + ramp, t[-1] + ramp + rng.uniform(0, 1.0)]
        x += [level, level]
    return np.interp(np.arange(n) / FS, t, x)


def coloured(rng, n, rho):
    e, out, y = rng.normal(size=n) * SIGMA * np.sqrt(1 - rho**2), np.empty(n), 0.0
    for i, value in enumerate(e):
        y = rho * y + value
        out[i] = y
    return out


def cycle(seed, n, valve=bent, rho=0.0, factor=1.0, T=40.0):
    """Samples of a cycle; Q is the valve's times ``factor``, plus noise of correlation ``rho``."""
    rng = np.random.default_rng(seed)
    U, dp = ramps_and_holds(rng, n, 0, 100), ramps_and_holds(rng, n, 3, 195)
    Q = valve(U, dp) * factor + coloured(rng, n, rho)
    t = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(n)
    return Samples.of(t, U, dp + 5, np.full(n, 5.0), Q, np.broadcast_to(T, n))


def drift(n, per_hour=-0.15):
    return 1 + per_hour * np.arange(n) / FS / 3600


def covered(kind, seeds, n=20_000):
    """Share of true flows inside the data within their 95 % intervals, and the map's RMSE, σ."""
    auto, within, errors = FlowMap(), [], []
    for seed in seeds:
        factor = drift(n) if kind == "drift" else np.ones(n)
        samples = cycle(seed, n, rho=0.95 if kind == "coloured" else 0.0, factor=factor)
        state, _ = auto.update(auto.initial_state(), samples)
        rng = np.random.default_rng(seed)
        U, dp = rng.uniform(0, 100, 400), rng.uniform(1, 199, 400)
        every = samples[::5]
        near = (np.abs(U[:, None] - every.U) < 5) & (np.abs(dp[:, None] - every.dp) < 5)
        U, dp = U[near.sum(axis=1) >= 3], dp[near.sum(axis=1) >= 3]
        Q, std = auto.predict(state, U, dp, np.full(len(U), 40.0))
        error = Q - bent(U, dp) * factor[-1]
        within.append(np.abs(error) <= 1.96 * std)
        errors.append(np.sqrt(np.mean(error**2)) / SIGMA)
    return np.concatenate(within).mean(), np.mean(errors)


@pytest.mark.parametrize(("kind", "most"), [("plain", 0.3), ("coloured", 0.8), ("drift", 0.3)])
def test_the_true_flow_is_covered_on_a_cycle(kind, most):
    share, error = covered(kind, range(3))
    assert share >= 0.85  # three seeds; forty: the soak
    assert error <= most


@pytest.mark.soak
@pytest.mark.parametrize("kind", ["plain", "coloured", "drift"])
def test_the_true_flow_is_covered_on_forty_cycles(kind):
    share, _ = covered(kind, range(100, 140))
    assert 0.90 <= share <= 0.98


@pytest.mark.parametrize("seed", range(3))
def test_damage_is_found_soon_after_flow_passes(seed):
    n, at = 13_500, 12_000
    auto, samples = FlowMap(), cycle(40 + seed, n, factor=1 - 0.1 * (np.arange(n) >= at))
    state, _ = auto.update(auto.initial_state(), samples[:at])
    assert auto.change_counts(state) == 0
    flowing = np.cumsum(bent(samples.U, samples.dp)[at:] * 0.9 > 10.0)
    state, _ = auto.update(state, samples[at : at + int(np.argmax(flowing > 150)) + 1])
    assert auto.change_counts(state) == 1


HEALTHY = {
    "white": {},
    "coloured": {"rho": 0.95},
    "misfit": {"valve": s_shape},
    "drift": {"factor": drift},
    "warming": {
        "T": lambda n: 60 - 20 * np.exp(-np.arange(n) / FS / 1200),
        "factor": lambda n: 1.04 - 0.04 * np.exp(-np.arange(n) / FS / 1200),
    },
}


def alarms(kind, seed, n):
    how = {name: x(n) if name in {"T", "factor"} else x for name, x in HEALTHY[kind].items()}
    auto = FlowMap()
    state, _ = auto.update(auto.initial_state(), cycle(seed, n, **how))
    return int(auto.change_counts(state))


@pytest.mark.parametrize("kind", HEALTHY)
def test_a_healthy_valve_has_no_change(kind):
    assert alarms(kind, 60, 20_000) == 0


@pytest.mark.soak
@pytest.mark.parametrize("kind", HEALTHY)
def test_a_healthy_valve_has_no_change_in_300_000_samples(kind):
    assert [alarms(kind, seed, 300_000) for seed in range(20)] == [0] * 20
