"""Parameters of `FlowMap` as published: flows, then physical quantities with their deviations."""

import numpy as np
import pytest

from valvemap.model import flow_map_looks
from valvemap.model.flow_map import FlowMap
from valvemap.model.samples import Samples


def learnt(estimator, shown, low=0.0, T=40.0):
    rng = np.random.default_rng(3)
    U, dp = rng.uniform(low, 100, 6000), rng.uniform(2, 198, 6000)
    t = 10**18 + np.arange(6000) * 10**7
    T = np.broadcast_to(T, 6000)
    Q = shown(U, dp, T) + 0.4 * rng.normal(size=6000)
    state, _ = estimator.update(
        estimator.initial_state(), Samples.of(t, U, dp, 0 * dp, Q, T.astype(float))
    )
    return dict(
        zip(estimator.parameter_names, np.transpose(estimator.parameters(state)), strict=True)
    )


def edge(U, dp, T):
    return 14 * np.clip((U - 5) / 95, 0, None) * np.sqrt(dp)


def test_gain_and_dead_band_are_those_of_the_valve():
    of = learnt(FlowMap(), edge)
    assert of["Q(50%,100bar)"][0] == pytest.approx(140 * 45 / 95, abs=0.4)
    assert of["gain_opening"][0] == pytest.approx(14, abs=0.05)
    assert of["dead_band_opening"][0] == pytest.approx(5 + 0.02 * 95, abs=0.3)
    assert 0 < of["dead_band_opening"][1] < 0.5
    assert of["gain_closing"].tolist() == [0.0, 0.0]
    assert of["play"][0] == 0.0


def test_a_valve_that_opens_both_ways_has_two_of_each():
    def shown(U, dp, T):
        return edge(U, dp, T) - 9 * np.clip((-U - 3) / 97, 0, None) * np.sqrt(dp)

    of = learnt(FlowMap(U_range=(-100.0, 100.0)), shown, -100.0)
    assert of["gain_closing"][0] == pytest.approx(9, abs=0.05)
    assert of["dead_band_closing"][0] == pytest.approx(3 + 0.02 * 97, abs=0.3)


def test_the_flow_rises_with_temperature_by_its_coefficient():
    T = np.linspace(30, 50, 6000)
    of = learnt(FlowMap(), lambda U, dp, T: edge(U, dp, T) * (1 + 0.003 * (T - 40)), T=T)
    assert of["temperature_coefficient"][0] == pytest.approx(0.003, abs=0.001)


def test_a_map_without_flow_at_full_signal_has_no_gain_and_no_division_by_it(monkeypatch):
    def falling(_state, _both, U, *_):
        return np.where(U.max() > U, U, 0.0), np.ones(len(U))

    monkeypatch.setattr(flow_map_looks, "predict", falling)
    of = learnt(FlowMap(), edge)
    assert of["gain_opening"][0] == 0.0
    assert of["dead_band_opening"].tolist() == [0.0, 100.0]


def test_before_samples_nothing_is_known_and_the_length_is_the_same():
    values, stds = FlowMap().parameters(FlowMap().initial_state())
    assert len(values) == len(stds) == len(FlowMap().parameter_names)
    assert np.isnan(values[:55]).all()
