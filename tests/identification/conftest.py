"""The table of estimators that every shared check runs on: a new one is one line here."""

import pytest

from service.identification.auto import Auto
from service.identification.forgetting import (
    Adaptive,
    Directional,
    Exponential,
    Resetting,
    SlidingWindow,
    Subspace,
    Variable,
)
from service.identification.maximum_likelihood import MaximumLikelihood
from service.identification.model_structures import TensorSpline
from service.identification.radial_basis import RadialBasis
from service.identification.rbf_network import RbfNetwork
from service.identification.recursive_least_squares import RecursiveLeastSquares

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
    "auto": Auto(),
}


@pytest.fixture(params=ESTIMATORS.values(), ids=ESTIMATORS.keys())
def estimator(request):
    return request.param
