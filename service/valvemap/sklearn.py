"""The flow map as a scikit-learn regressor (extra ``[sklearn]``)."""

import math
import warnings
from collections.abc import Sequence
from typing import Any, Final, Self

import numpy as np
from numpy.typing import ArrayLike

from valvemap.model.extrapolation import ABOUT_DP, ABOUT_U, within_ranges
from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import Exponential, Forgetting
from valvemap.model.least_squares_answers import parameter_covariance, predict
from valvemap.model.least_squares_learning import learn
from valvemap.model.least_squares_state import initial_state
from valvemap.model.model_structures import FiveTerms, Structure
from valvemap.model.samples import Floats, Samples

try:
    from sklearn.base import BaseEstimator, RegressorMixin
    from sklearn.utils.validation import check_is_fitted, validate_data
except ImportError as error:
    raise ImportError(
        "valvemap.sklearn needs scikit-learn: pip install valvemap[sklearn]"
    ) from error


_OTHER_COLUMNS: Final = "it fits X of 4, 5 or 10 columns; the columns are U, dp or U, dp, T"
EXPECTED_FAILURES: Final = dict.fromkeys(
    (
        "check_n_features_in_after_fitting",
        "check_positive_only_tag_during_fit",
        "check_estimators_dtypes",
        "check_dtype_object",
        "check_regressors_train",
        "check_regressor_data_not_an_array",
        "check_regressors_no_decision_function",
        "check_regressors_int",
        "check_fit2d_1sample",
    ),
    _OTHER_COLUMNS,
)
"""Checks of scikit-learn that `AutoFlowMap` fails, and why: ``check_estimator(AutoFlowMap(),
expected_failed_checks=EXPECTED_FAILURES)`` passes."""


_MOST_BEYOND: Final = 0.01  # of the rows
_HARDLY: Final = 0.05  # of both ranges; no map is of so small a part


def _range(name: str, given: Sequence[float]) -> tuple[float, float]:
    try:
        low, high = map(float, given)
    except (TypeError, ValueError):
        low = high = math.nan
    if not (math.isfinite(high - low) and low < high):
        raise ValueError(f"{name} is {given!r}; a low and a high end are allowed, as (0, 100)")
    return low, high


class _SampleBySample(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """Fits at once, or in parts as samples come."""

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Learn from N samples and from no earlier ones: X (N, n_features), y (N,) in l/min."""
        rows, output = validate_data(self, X, y, dtype=np.float64, y_numeric=True)
        self._begin()
        return self._learn(rows, output)

    def partial_fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Learn from further samples, in their order."""
        first = not hasattr(self, "state_")
        rows, output = validate_data(self, X, y, dtype=np.float64, y_numeric=True, reset=first)
        if first:
            self._begin()
        return self._learn(rows, output)

    def _begin(self) -> None:
        raise NotImplementedError

    def _learn(self, X: Floats, y: Floats) -> Self:
        raise NotImplementedError


class FlowMapRegressor(_SampleBySample):
    """Recursive least squares on a flow map, `fit` at once or `partial_fit` as samples come.

    Parameters
    ----------
    structure : Structure, optional
        Regressors of (U, dp[, T]), from :mod:`valvemap.model.model_structures`. Default:
        eq. (7) on the first two columns of X, U (%) and dp (bar), any others entering linearly; a
        straight line for a single column.
    forgetting : float or Forgetting
        λ of exponential forgetting, or a rule of :mod:`valvemap.model.forgetting`.
    p0 : float
        P(0) = p0·I; infinite: exact least squares.

    Attributes
    ----------
    theta_ : (n,)
        Parameters; a direction that the samples leave open counts as 0.
    covariance_ : (n, n)
        Their covariance; NaN while not determined.
    state_ : RlsState
        The state that the next `partial_fit` continues from.
    n_features_in_ : int
        Columns of X.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X = np.column_stack([rng.uniform(0, 100, 200), rng.uniform(0, 200, 200)])
    >>> Q = 1.0 + 0.12 * X[:, 0] * np.sqrt(X[:, 1])
    >>> FlowMapRegressor().fit(X, Q).predict([[50.0, 100.0]]).round(6)
    array([61.])
    """

    def __init__(
        self,
        structure: Structure | None = None,
        forgetting: float | Forgetting = 1.0,
        p0: float = np.inf,
    ) -> None:
        self.structure = structure
        self.forgetting = forgetting
        self.p0 = p0

    def predict(self, X: ArrayLike, *, return_std: bool = False) -> Floats | tuple[Floats, Floats]:
        """Flow (N,), l/min, and if wanted its standard deviation (N,), NaN where unknown."""
        check_is_fitted(self)
        rows = self._regressors(validate_data(self, X, dtype=np.float64, reset=False))
        Q = np.sum(rows * self.theta_, axis=1)
        return (Q, predict(self.state_, rows, self._rule())[1]) if return_std else Q

    def _begin(self) -> None:
        n = self._regressors(np.zeros((1, self.n_features_in_))).shape[1]
        self.state_ = initial_state(n, self._rule(), self.p0)

    def _learn(self, X: Floats, y: Floats) -> Self:
        N, rows = len(y), self._regressors(X)
        output = np.asarray(y, np.float64)
        self.state_, _ = learn(
            self.state_, self._rule(), rows, output, np.arange(N), np.ones(N, np.uint8)
        )
        self.theta_ = self.state_.theta
        self.covariance_ = parameter_covariance(self.state_, self._rule())
        return self

    def _rule(self) -> Forgetting:
        given = self.forgetting
        return given if isinstance(given, Forgetting) else Exponential(float(given))

    def _regressors(self, X: Floats) -> Floats:
        columns: list[Any] = list(np.ascontiguousarray(X.T))
        if self.structure is not None:
            if len(columns) < 2:
                raise ValueError("X has 1 column; a structure wants U, dp and, if it uses it, T")
            T = columns[2] if len(columns) > 2 else np.full(len(X), np.nan)
            return self.structure.regressors(columns[0], columns[1], T)
        if len(columns) == 1:
            return np.stack([np.ones(len(X)), columns[0]], axis=1)
        U, dp, *others = columns
        return np.column_stack([FiveTerms().regressors(U, dp, np.full(len(X), np.nan)), *others])


class AutoFlowMap(_SampleBySample):
    """The flow map as one Gaussian model, learnt sample by sample as the service's `Auto` does.

    The columns of X are fixed: U (%), dp (bar) and optionally T (°C). Those of
    scikit-learn's checks that need other columns fail, see `EXPECTED_FAILURES`.

    Parameters
    ----------
    lam : float
        Forgetting factor of a cell of the map, per sample that falls into it.
    interval : float
        Time between two samples, s: rows are taken to be in the order of time.
    U_range, dp_range : (float, float)
        Of the valve, % and bar.

    Attributes
    ----------
    state_ : FlowMapState
        State for the next `partial_fit`.
    structure_ : str
        The effects in force in words.
    n_features_in_ : int
        Columns of X.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X = np.column_stack([rng.uniform(0, 100, 3000), rng.uniform(5, 200, 3000)])
    >>> Q = 2.0 * np.clip(X[:, 0] - 6.0, 0.0, 90.0) * np.sqrt(X[:, 1] / 200.0)
    >>> AutoFlowMap().fit(X, Q).predict([[50.0, 100.0]]).round(1)
    array([62.2])
    """

    def __init__(
        self,
        lam: float = 0.998,
        interval: float = 0.01,
        U_range: Sequence[float] = (0.0, 100.0),
        dp_range: Sequence[float] = (0.0, 200.0),
    ) -> None:
        self.lam = lam
        self.interval = interval
        self.U_range = U_range
        self.dp_range = dp_range

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Learn from N samples and from no earlier ones: X (N, n_features), y (N,) in l/min."""
        super().fit(X, y)
        U, dp, _ = self._signals(validate_data(self, X, dtype=np.float64, reset=False))
        self._warn_of_ranges(U, dp)
        return self

    def predict(self, X: ArrayLike, *, return_std: bool = False) -> Floats | tuple[Floats, Floats]:
        """Flow (N,), l/min, and if wanted its standard deviation (N,), NaN where unknown.

        Beyond the ranges the flow is that of the border, and its standard deviation is unknown.
        """
        check_is_fitted(self)
        rows = validate_data(self, X, dtype=np.float64, reset=False)
        auto, (U, dp, T) = self._auto(), self._signals(rows)
        Q, std = auto.predict(self.state_, U, dp, T)
        std = np.where(within_ranges(auto, U, dp), std, np.nan)
        return (Q, std) if return_std else Q

    def _begin(self) -> None:
        if self.n_features_in_ not in (2, 3):
            raise ValueError(
                f"X has {self.n_features_in_} feature(s); U, dp or U, dp, T are allowed"
            )
        if not self.interval > 0.0:
            raise ValueError(
                f"interval is {self.interval!r}; a number of seconds above 0 is allowed"
            )
        self.state_ = self._auto().initial_state()
        self._seen = 0

    def _learn(self, X: Floats, y: Floats) -> Self:
        U, dp, T = self._signals(X)
        step = round(self.interval * 1e9)
        t = step * np.arange(self._seen, self._seen + len(X))
        samples = Samples.of(t, U, dp, np.zeros_like(dp), np.asarray(y, np.float64), T)
        self.state_, _ = self._auto().update(self.state_, samples)
        self._seen += len(X)
        self.structure_ = self._auto().describe(self.state_)
        return self

    def _warn_of_ranges(self, U: Floats, dp: Floats) -> None:
        """Warn of samples that this map cannot have: beyond its ranges, or scaled."""
        auto = self._auto()
        shown = (
            f"U is {U.min():.3g} … {U.max():.3g} % and dp {dp.min():.3g} … {dp.max():.3g} bar; "
            f"U_range = {auto.U_range}, dp_range = {auto.dp_range}"
        )
        beyond = 1.0 - float(np.mean(within_ranges(auto, U, dp, ABOUT_U, ABOUT_DP)))
        spans = np.ptp(auto.U_range), np.ptp(auto.dp_range)
        if beyond > _MOST_BEYOND:
            warnings.warn(f"{beyond:.0%} of the rows are not learnt: {shown}", stacklevel=3)
        elif np.ptp(U) < _HARDLY * spans[0] and np.ptp(dp) < _HARDLY * spans[1]:
            warnings.warn(f"X is in % and bar, without a scaler: {shown}", stacklevel=3)

    def _auto(self) -> FlowMap:
        U_range, dp_range = _range("U_range", self.U_range), _range("dp_range", self.dp_range)
        return FlowMap(U_range, dp_range, self.lam)

    def _signals(self, X: Floats) -> tuple[Floats, Floats, Floats]:
        U, dp, *others = (np.ascontiguousarray(column) for column in X.T)
        return U, dp, others[0] if others else np.full(len(X), np.nan)
