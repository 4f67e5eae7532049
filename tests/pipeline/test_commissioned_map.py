"""A commissioned map of the rig's valve, in simulated time, and where responses are late."""

import numpy as np
import pytest

from benchmarks.commission_plant import Loop, RigPlant
from support.soaked import soaked
from valvemap.config.estimators import AutoConfig, build_estimator
from valvemap.pipeline.commission_limits import Limits
from valvemap.pipeline.commission_plan import Plan
from valvemap.pipeline.commission_state import Reason, Settings
from valvemap.vocabulary.commission import Phase
from valvemap_rig.circuit import Bench, true_flow

LIMITS = Limits(
    U_range=(0.0, 80.0),
    slew_percent_per_s=300.0,
    load_range=(20.0, 190.0),
    load_slew_bar_per_s=600.0,
    safe_load=150.0,
)


@pytest.mark.parametrize(("seed", "response_s"), [(1, 0.03), *soaked((0, 0.0))])
def test_a_driven_load_tells_the_map_within_14_s(seed, response_s):
    estimator = build_estimator(AutoConfig(), (0.0, 100.0), (0.0, 200.0), (0.0, 200.0))
    settings = Settings(LIMITS, Plan(sweep_s=10.0, most_s=14.0), opening=3.5)
    loop = Loop(RigPlant(seed), settings, estimator=estimator, response_s=response_s).run(20.0)
    assert (loop.state.phase, loop.state.reason) == (Phase.DONE, Reason.TIME_UP)
    t, U = np.array(loop.log.writes).T
    assert (np.abs(np.diff(U)) <= 300.0 * (np.diff(t) - response_s) + 1e-9).all()
    U, dp = (x.ravel() for x in np.meshgrid(np.linspace(5, 75, 15), np.linspace(20, 150, 8)))
    Q, _ = estimator.predict(loop.catch_up().state, U, dp, np.full(U.shape, 40.0))
    assert np.sqrt(np.mean((Q - true_flow(Bench(), U, dp)) ** 2)) < 0.5
