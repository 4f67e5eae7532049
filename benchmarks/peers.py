"""Recursive least squares of other packages, one sample at a time, each by its own means.

None of them is a dependency of the project; those that are not installed are left out.
"""

from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from benchmarks.measured_data import Floats

Peer = Callable[[Floats, Floats, float], Floats]
Follower = Callable[[Floats, Floats, float], Floats]


def padasip(X: Floats, y: Floats, p0: float) -> Floats:
    """FilterRLS: λ = mu = 1, P(0) = 1/eps."""
    filter_ = _padasip_filter(X.shape[1], 1.0, p0)
    for x, value in zip(X, y, strict=True):
        filter_.adapt(value, x)
    return filter_.w


def river(X: Floats, y: Floats, p0: float) -> Floats:
    """BayesianLinearRegression: the prior's precision is 1/p0, that of the noise 1."""
    from river.linear_model import BayesianLinearRegression  # noqa: PLC0415 - optional

    model = BayesianLinearRegression(alpha=1.0 / p0, beta=1.0)
    for x, value in zip(X, y, strict=True):
        model.learn_one(dict(enumerate(x)), value)
    return np.array([model.predict_one(dict(enumerate(row))) for row in np.eye(X.shape[1])])


def filterpy(X: Floats, y: Floats, p0: float) -> Floats:
    """KalmanFilter: the state is constant, the noise of one measurement 1."""
    filter_ = _kalman_filter(X.shape[1], 1.0, p0)
    for x, value in zip(X, y, strict=True):
        filter_.update(value, H=x[None, :])
    return filter_.x.ravel()


def statsmodels(X: Floats, y: Floats, p0: float) -> Floats:  # noqa: ARG001 - starts diffuse
    """RecursiveLS, which starts exactly diffuse whatever p0."""
    from statsmodels.regression.recursive_ls import RecursiveLS  # noqa: PLC0415 - optional

    return np.asarray(RecursiveLS(y, X).fit().params)


PEERS: dict[str, Peer] = {
    "padasip": padasip,
    "river": river,
    "filterpy": filterpy,
    "statsmodels": statsmodels,
}


def padasip_follows(X: Floats, y: Floats, lam: float) -> Floats:
    """Innovations (N,) of FilterRLS with mu = λ."""
    filter_ = _padasip_filter(X.shape[1], lam, 1e8)
    innovations = np.empty(len(y))
    for t, (x, value) in enumerate(zip(X, y, strict=True)):
        innovations[t] = value - filter_.predict(x)
        filter_.adapt(value, x)
    return innovations


def river_follows(X: Floats, y: Floats, lam: float) -> Floats:
    """Innovations (N,) of BayesianLinearRegression, whose smoothing is λ."""
    from river.linear_model import BayesianLinearRegression  # noqa: PLC0415 - optional

    model = BayesianLinearRegression(alpha=1e-8, beta=1.0, smoothing=lam)
    innovations = np.empty(len(y))
    for t, (row, value) in enumerate(zip(X, y, strict=True)):
        x = dict(enumerate(row))
        innovations[t] = value - model.predict_one(x)
        model.learn_one(x, value)
    return innovations


def filterpy_follows(X: Floats, y: Floats, lam: float) -> Floats:
    """Innovations (N,) of KalmanFilter with a fading memory, alpha² = 1/λ, no process noise."""
    filter_ = _kalman_filter(X.shape[1], lam, 1e8)
    innovations = np.empty(len(y))
    for t, (x, value) in enumerate(zip(X, y, strict=True)):
        filter_.predict()
        innovations[t] = value - x @ filter_.x.ravel()
        filter_.update(value, H=x[None, :])
    return innovations


FOLLOWERS: dict[str, Follower] = {
    "padasip": padasip_follows,
    "river": river_follows,
    "filterpy": filterpy_follows,
}


def installed() -> dict[str, str]:
    """Versions of those peers that are there."""
    versions = {}
    for name in PEERS:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return versions


def _padasip_filter(n, lam, p0):
    from padasip.filters import FilterRLS  # noqa: PLC0415 - optional

    return FilterRLS(n=n, mu=lam, eps=1.0 / p0, w="zeros")


def _kalman_filter(n, lam, p0):
    from filterpy.kalman import KalmanFilter  # noqa: PLC0415 - optional

    filter_ = KalmanFilter(dim_x=n, dim_z=1)
    filter_.P *= p0
    filter_.Q *= 0.0
    filter_.alpha = lam**-0.5
    return filter_
