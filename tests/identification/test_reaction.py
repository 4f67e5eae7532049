"""U that reacts to the noise of the same sample is told from all else, and said."""

import numpy as np
import pytest

from benchmarks import circumstances as c
from service.identification.adaptation import Adaptation
from service.identification.auto import Auto
from service.identification.forgetting import Adaptive
from service.identification.kernels import reaction
from service.identification.maximum_likelihood import MaximumLikelihood
from service.identification.recursive_least_squares import RecursiveLeastSquares

N = 6_000
ESTIMATORS = {
    "RLS": RecursiveLeastSquares(forgetting=Adaptive()),
    "RML": MaximumLikelihood(lam=0.999),
    "Auto": Auto(),
}


def says(estimator, U, dp, Q):
    state, _ = estimator.update(estimator.initial_state(), c.samples_of(U, dp, Q))
    said = estimator.adaptation(state)
    of_many = estimator.adaptation_many(
        type(state)(*(np.asarray(x)[None] for x in vars(state).values()))
    )
    assert of_many.tolist() == [said]
    return said, state


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("noise", [c.white, c.ar])
def test_U_that_reacts_is_said_to(name, noise):
    (U, dp), e = c.cycle(70, N), noise(70, N)
    U = c.reacting(U, e, gain=0.8)
    said, state = says(ESTIMATORS[name], U, dp, c.ordinary(U, dp) + e)
    assert said == Adaptation.REACTING
    if name == "Auto":  # smoothed by a lag its jitter would seem to explain the flow better
        assert ESTIMATORS[name].lags(state) == (0.0, 0.0)


def healthy(kind):
    (U, dp), e = c.cycle(71, N), c.white(71, N)
    Q = c.ordinary(U, dp) + e
    match kind:
        case "lag of Q":
            Q = c.lagged(c.ordinary(U, dp), 0.2) + e
        case "lag of U":
            Q = c.ordinary(c.lagged(U, 0.1), dp) + e
        case "slow noise":
            Q = c.ordinary(U, dp) + c.ar(71, N)
        case "closed loop":
            U, dp, Q = c.closed_loop(71, N, c.ordinary)
        case "misfit":
            Q = c.s_shape(U, dp) + e
        case "scattered":  # it does react, but next to what else moves U that is nothing
            U, dp = c.scattered(71, N)
            U = c.reacting(U, e)
            Q = c.ordinary(U, dp) + e
        case "scattered misfit":
            U, dp = c.scattered(71, N)
            Q = c.s_shape(U, dp) + e
        case "steps behind a meter":
            U, dp = c.structured(per_level=300)
            Q = c.lagged(c.ordinary(U, dp), 0.2) + c.white(71, len(U))
        case "U in steps of the converter":
            U = np.round(U / 0.05) * 0.05
    return U, dp, Q


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize(
    "kind",
    [
        *("white", "lag of Q", "lag of U", "slow noise", "closed loop", "misfit", "scattered"),
        *("scattered misfit", "steps behind a meter", "U in steps of the converter"),
    ],
)
def test_nothing_else_is_taken_for_it(name, kind):
    said, _ = says(ESTIMATORS[name], *healthy(kind))
    assert said != Adaptation.REACTING


def test_a_controller_that_answers_the_sample_before_agrees_as_theory_says():
    rng = np.random.default_rng(1)
    e = rng.normal(size=20_000)
    for u, r in ((-0.5 * e, -(0.75**0.5)), (-0.5 * np.roll(e, 1), 12**-0.5)):
        state = np.zeros(reaction.PLACES)
        for value, error in zip(u, e, strict=True):
            reaction.weigh(state, 0, value, error)
        agreed = state[reaction.AGREED] / state[reaction.JITTERY]
        assert agreed == pytest.approx(2.0 / np.pi * np.arcsin(r), abs=0.08)
        assert reaction.reacts(state, 0) == (abs(r) > 0.5)


def test_a_valve_that_first_stands_still_is_looked_at_all_the_same():
    U, dp = c.cycle(72, N)
    U[:1000], e = 50.0, c.white(72, N)
    U[1000:] = c.reacting(U, e)[1000:]
    said, _ = says(ESTIMATORS["RLS"], U, dp, c.eq7(U, dp) + e)
    assert said == Adaptation.REACTING
