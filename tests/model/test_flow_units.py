"""A state converted to another unit of flow is the one that would have been learnt in it."""

from dataclasses import fields

import numpy as np
import pytest

from valvemap.model.flow_map import FlowMap
from valvemap.model.flow_units import FlowHomogeneous, in_flow_unit
from valvemap.model.forgetting import (
    Adaptive,
    Directional,
    Exponential,
    Resetting,
    SlidingWindow,
    Subspace,
    Variable,
)
from valvemap.model.maximum_likelihood import MaximumLikelihood
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.model.tensor_spline import TensorSpline

GPM = 3.785411784  # l/min


def stream(factor, N=3000):
    """A valve that changes half-way, U moving in steps, with coloured noise."""
    rng = np.random.default_rng(3)
    U = np.clip(np.repeat(rng.uniform(5, 95, N // 20), 20) + rng.normal(0, 0.1, N), 0, 100)
    dp = np.clip(100 + 60 * np.sin(np.arange(N) / 300) + rng.normal(0, 1, N), 1, 199)
    Q = 1 + 0.02 * U + 0.1 * np.sqrt(dp) + 0.12 * U * np.sqrt(dp) + 0.01 * dp
    Q[N // 2 :] *= 1.2
    e = rng.normal(0, 1, N + 1)
    Q += e[1:] + 0.6 * e[:-1]
    return Samples.of(np.arange(N) * 100_000_000, U, dp, 0 * dp, Q * factor, T=np.full(N, 40.0))


RLS = RecursiveLeastSquares
CONVERTED = {
    "least squares": RLS(),
    "exponential": RLS(forgetting=Exponential(0.99)),
    "variable": RLS(forgetting=Variable(0.995)),
    "resetting": RLS(forgetting=Resetting(0.99)),
    "directional": RLS(forgetting=Directional(0.99)),
    "subspace": RLS(forgetting=Subspace(0.99)),
    "window": RLS(forgetting=SlidingWindow(50)),
    "adaptive": RLS(forgetting=Adaptive()),
    "adaptive that forgets": RLS(forgetting=Adaptive(0.999)),
    "maximum likelihood": MaximumLikelihood(lam=0.999),
    "longer noise": MaximumLikelihood(nd=3),
}


@pytest.mark.parametrize("other", [RLS(p0=1e3), RLS(TensorSpline.uniform())], ids=["p0", "prior"])
def test_a_prior_in_units_of_the_flow_has_no_exact_conversion(other):
    assert other.flow_powers(other.initial_state()) is None


@pytest.mark.parametrize("other", [RbfNetwork(), FlowMap()], ids=["RBF", "Auto"])
def test_what_learns_by_steps_or_chooses_has_no_exact_conversion(other):
    assert not isinstance(other, FlowHomogeneous)


@pytest.mark.parametrize("one", CONVERTED.values(), ids=CONVERTED)
@pytest.mark.parametrize("learnt", [100, 777, 2900])
def test_a_state_in_twice_the_unit_is_the_same_bits(one, learnt):
    before, after = (
        one.update(one.initial_state(), stream(factor)[:learnt])[0] for factor in (1.0, 2.0)
    )
    converted = in_flow_unit(before, one.flow_powers(before), 2.0)
    for f in fields(after):
        got, wanted = getattr(converted, f.name), getattr(after, f.name)
        assert np.array_equal(got, wanted, equal_nan=got.dtype.kind == "f"), f.name
        assert got.dtype == wanted.dtype


@pytest.mark.parametrize(
    "one",
    [
        RecursiveLeastSquares(forgetting=Adaptive()),
        RecursiveLeastSquares(forgetting=Adaptive(0.999)),
        MaximumLikelihood(lam=0.999),
        MaximumLikelihood(nd=3),
    ],
    ids=repr,
)
def test_a_state_in_gallons_goes_on_within_1e_9_of_one_learnt_in_gallons(one):
    wrong, right = stream(1.0), stream(GPM)
    before, _ = one.update(one.initial_state(), wrong[:1000])
    converted = in_flow_unit(before, one.flow_powers(before), GPM)
    learnt, _ = one.update(one.initial_state(), right[:1000])
    for _ in range(2):
        for got, wanted in zip(one.parameters(converted), one.parameters(learnt), strict=True):
            assert got == pytest.approx(wanted, rel=1e-9)
        converted, _ = one.update(converted, right[1000:])
        learnt, _ = one.update(learnt, right[1000:])
