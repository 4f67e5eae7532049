"""Maps of a valve with a dead band and their tables, made once for all files that export them."""

from functools import cache
from typing import NamedTuple

import numpy as np

from valvemap.model.flow_map import FlowMap
from valvemap.model.lookup_table import lookup_table
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.model.support import Support
from valvemap.model.tensor_spline import TensorSpline

N = 5_000
COARSE, FINE = (21, 16), (41, 31)  # points of a table; FINE by default, and bounded more slowly
WHOLE, PART = ((0, 100), (1, 200)), ((5, 40), (5, 60))  # U, %, and dp, bar, of the samples
ESTIMATORS = {
    "eq. (7)": RecursiveLeastSquares(),
    "spline": RecursiveLeastSquares(TensorSpline.uniform(6, 4)),
    "kinked spline": RecursiveLeastSquares(
        TensorSpline((0, 30, 100), (0, 7, 15), (), 8.0, 91.0, at_rest="zero")
    ),
    "network": RbfNetwork(),
    "auto": FlowMap(),
}


class Exported(NamedTuple):
    """An estimator, its state, and the inverse of its map as a table."""

    estimator: object
    state: object
    inverse: object


def dead_band(U, dp):
    """Flow of the valve, l/min."""
    return 2.0 * np.clip(U - 6.0, 0, 90) * np.sqrt(dp / 200)


@cache
def exported_map(name, points, ranges=WHOLE):
    """The map that an estimator learns of N samples, and its table; neither may be changed."""
    estimator, rng = ESTIMATORS[name], np.random.default_rng(4)
    U, dp = (rng.uniform(*ends, N) for ends in ranges)
    Q = dead_band(U, dp) + 0.3 * rng.normal(size=N)
    samples = Samples.of(np.arange(N), U, dp, 0 * dp, Q, np.full(N, 40.0))
    state, trace = estimator.update(estimator.initial_state(), samples)
    support = Support.none().add(samples, trace)
    return Exported(
        estimator, state, lookup_table(estimator, state, support=support, points=points)
    )
