"""What a commissioning run has learnt: the range that is judged, and what the supply gives."""

import numpy as np

from benchmarks.commission_plant import VALVES, settings_for
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.pipeline.commission_learner import Learnt, Supply, learn, uncertainty
from valvemap.pipeline.commission_limits import Point

N = 4000


def swept(pump=np.inf, p1=200.0, seed=0):
    """A linear valve of 14 l/min/√bar behind a pump that gives at most ``pump`` l/min."""
    t = np.arange(N) / 100.0
    U, load = 50 - 50 * np.cos(t), 0.5 * p1 - (0.5 * p1 - 5) * np.cos(1.618 * t)
    wanted = 0.14 * U * np.sqrt(p1 - load)
    Q = np.minimum(wanted, pump)
    dp = (p1 - load) * (Q / np.maximum(wanted, 1e-9)) ** 2
    noise = np.random.default_rng(seed).normal(0.0, 0.4, N)
    return Samples.of(np.arange(N) * 10_000_000, U, load + dp, load, Q + noise, 0 * U + 40.0)


def learnt_from(samples):
    settings = settings_for(VALVES["ordinary, no play"])
    estimator = RecursiveLeastSquares()
    before = Learnt(estimator.initial_state())
    found = learn(estimator, settings, before, samples, Point(0.0, 150.0))
    return uncertainty(estimator, settings.limits.U_range, found), found


def test_the_whole_range_is_judged_where_the_supply_gives_all_that_is_asked_for():
    at, found = learnt_from(swept())
    assert found.supply.limit == np.inf
    assert len(at.U) == 33 * 13


def test_what_the_supply_cannot_give_is_not_judged():
    at, found = learnt_from(swept(pump=100.0))
    assert abs(found.supply.limit - 100.0) < 2.0
    flow = 0.14 * at.U * np.sqrt(at.dp)
    assert flow.max() < 106.0
    assert ((at.U == 100.0) & (at.dp < 50.0)).any()  # reached where little is asked for


def test_a_supply_whose_pressure_differs_for_other_reasons_has_no_limit():
    supply = Supply()
    for p1 in (150.0, 200.0, 150.0):
        supply = supply.after(swept(p1=p1))
        assert supply.limit == np.inf


def test_the_supply_is_the_same_in_one_batch_or_in_many():
    samples, supply = swept(pump=100.0), Supply()
    for first in range(0, N, 400):
        supply = supply.after(samples[first : first + 400])
    whole = Supply().after(samples)
    assert supply.most == whole.most
    assert np.allclose(supply.p1, whole.p1, rtol=0.1)
    assert supply.limit == whole.limit
