"""The table of estimators that every shared check runs on: a new one is one line here."""

import pytest

from valvemap.model.flow_map import FlowMap
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
from valvemap.model.radial_basis import RadialBasis
from valvemap.model.rbf_network import RbfNetwork
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.tensor_spline import TensorSpline

ESTIMATORS = {
    "least squares": RecursiveLeastSquares(),
    "ridge": RecursiveLeastSquares(p0=1e3),
    "exponential": RecursiveLeastSquares(forgetting=Exponential(0.99)),
    "variable": RecursiveLeastSquares(forgetting=Variable(0.995)),
    "resetting": RecursiveLeastSquares(forgetting=Resetting(0.99)),
    "directional": RecursiveLeastSquares(forgetting=Directional(0.99)),
    "subspace": RecursiveLeastSquares(forgetting=Subspace(0.99)),
    "window": RecursiveLeastSquares(forgetting=SlidingWindow(50)),
    "adaptive": RecursiveLeastSquares(forgetting=Adaptive()),
    "spline": RecursiveLeastSquares(TensorSpline.uniform(), Adaptive()),
    "radial basis": RecursiveLeastSquares(RadialBasis.uniform(), Adaptive()),
    "maximum likelihood": MaximumLikelihood(),
    "network": RbfNetwork(),
    "auto": FlowMap(),
}


@pytest.fixture(params=ESTIMATORS.values(), ids=ESTIMATORS.keys())
def estimator(request):
    return request.param
