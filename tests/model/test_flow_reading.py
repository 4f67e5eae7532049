"""Noise that grows with the reading."""

import numpy as np
import pytest

from benchmarks import circumstances as honest
from valvemap.model.flow_map import FlowMap
from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_reading as readings
from valvemap.vocabulary.statuses import Adaptation

MANY = 30_000


def ratio(state, flow):
    """Variance of the noise at a flow, in usual ones."""
    part, mean = state.scalars[fits.READING + np.array([readings.PART, readings.MEAN])]
    return max(1.0 + part * (flow**2 - mean), 1.0)


def learnt(share, seed, least=0.05):
    """A valve whose meter is off by a share of the reading, and `least` l/min."""
    U, dp = honest.cycle(seed, MANY)
    flow = honest.s_shape(U, dp)
    error = (share * np.abs(flow) + least) * honest.white(seed, MANY) / honest.SIGMA
    estimator = FlowMap()
    state, _ = estimator.update(estimator.initial_state(), honest.samples_of(U, dp, flow + error))
    return estimator, state, (U, dp)


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(n, marks=pytest.mark.soak) for n in range(1, 9))]
)
def test_noise_of_the_reading_is_neither_change_nor_misfit(seed):
    estimator, state, _ = learnt(0.015, seed)
    assert estimator.last_change(state) is None
    assert not estimator.findings(state)
    assert estimator.adaptation(state) is not Adaptation.MISFIT


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_noise_where_much_flows_is_estimated(seed):
    _, state, _ = learnt(0.02, seed)
    for flow in (75.0, 90.0):
        sigma = np.sqrt(state.scalars[fits.VARIANCE] * ratio(state, flow))
        assert sigma == pytest.approx(0.02 * flow, rel=0.2)
    assert ratio(state, 10.0) == 1.0
    assert ratio(state, 90.0) > 1.2


def test_noise_that_is_alike_everywhere_has_no_part_of_the_reading():
    for seed in range(3):
        _, state, _ = learnt(0.0, seed, honest.SIGMA)
        assert ratio(state, 100.0) < 1.2
