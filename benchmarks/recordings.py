"""Figures on recordings of real machines: a cooling circuit, an actuator, an air valve."""

from dataclasses import dataclass

import numpy as np

from benchmarks.measured_data import SECOND, Dynamics, Floats
from valvemap.model.armax import recursive_maximum_likelihood
from valvemap.model.estimator import Estimator
from valvemap.model.forgetting import Forgetting
from valvemap.model.least_squares_of_arrays import recursive_least_squares
from valvemap.model.model_structures import Polynomial
from valvemap.model.samples import Samples

COOLING_CIRCUIT = Polynomial(("1", "dp", "T", "dp*T"))
SETTLED = 60  # samples of the cooling circuit that are not judged
TRAINING = 512  # samples of the actuator that may teach
SWEEPS = 5  # times that the air valve's points are gone through, up and down


def r2(y: Floats, error: Floats) -> float:
    """1 - Σe²/Σ(y - mean)²."""
    return float(1.0 - error @ error / np.sum((y - y.mean()) ** 2))


def rmse(error: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(error**2)))


def settled_r2(Q: Floats, innovations: Floats) -> float:
    """R² without the first minute."""
    return r2(Q[SETTLED:], innovations[SETTLED:])


def cooling_circuit_regressors(samples: Samples) -> Floats:
    """Rows 1, dp, T, dp·T."""
    return COOLING_CIRCUIT.regressors(samples.U, samples.dp, samples.T)


def one_step_ahead(samples: Samples, forgetting: Forgetting) -> float:
    """R² of predictions made before the sample, in chronological order."""
    X = cooling_circuit_regressors(samples)
    return settled_r2(samples.Q, recursive_least_squares(X, samples.Q, forgetting).innovations)


@dataclass(frozen=True)
class Ahead:
    """R² of Q(t + h) predicted at t, by frozen parameters and by the last flow measured.

    Attributes
    ----------
    frozen
        Xᵀ(t + h)·theta(t): parameters of time t, dp and T as measured at t + h.
    persistence
        Q(t): knows nothing of dp and T.
    """

    frozen: float
    persistence: float


def ahead(samples: Samples, theta_history: Floats, h: int) -> Ahead:
    """Freeze the parameters h seconds before each sample that is predicted."""
    X, Q = cooling_circuit_regressors(samples), samples.Q
    future, now = slice(SETTLED - 1 + h, None), slice(SETTLED - 1, len(Q) - h)
    return Ahead(
        frozen=r2(Q[future], Q[future] - (X[future] * theta_history[now]).sum(axis=1)),
        persistence=r2(Q[future], Q[future] - Q[now]),
    )


@dataclass(frozen=True)
class Verified:
    """A model of the actuator, taught by the first half and verified on the second.

    Attributes
    ----------
    theta
        a1 …, b1 …, d1 …
    one_step
        RMSE one step ahead, parameters frozen, noise model at work.
    simulated
        RMSE of the simulation from u alone.
    """

    theta: Floats
    one_step: float
    simulated: float


def arx(data: Dynamics, na: int, nb: int) -> Verified:
    """A(q)·y = B(q)·u + v by recursive least squares."""
    X = _lags(data, na, nb)
    first = max(na, nb)
    theta = recursive_least_squares(X[first:TRAINING], data.y[first:TRAINING]).theta
    return verified(data, theta, na, nb)


def armax(data: Dynamics, na: int, nb: int, nd: int, p0: float) -> Verified:
    """A(q)·y = B(q)·u + D(q)·v by recursive maximum likelihood."""
    u, y = data.u[:TRAINING], data.y[:TRAINING]
    theta = recursive_maximum_likelihood(y, u, na, nb, nd, p0=p0).theta
    return verified(data, theta, na, nb)


def verified(data: Dynamics, theta: Floats, na: int, nb: int) -> Verified:
    """Freeze theta and go over the second half, once with each y(t - 1), once without."""
    model, d = theta[: na + nb], theta[na + nb :]
    error = data.y - _lags(data, na, nb) @ model
    v = np.zeros(len(error))
    for t in range(max(na, nb), len(error)):
        v[t] = error[t] - sum(d[i] * v[t - 1 - i] for i in range(min(len(d), t)))
    simulated = data.y.copy()
    for t in range(TRAINING, len(simulated)):
        lags = [-simulated[t - i] for i in range(1, na + 1)]
        simulated[t] = model @ np.array(lags + [data.u[t - i] for i in range(1, nb + 1)])
    return Verified(theta, rmse(v[TRAINING:]), rmse((data.y - simulated)[TRAINING:]))


def _lags(data: Dynamics, na: int, nb: int) -> Floats:
    """Rows -y(t-1) …, u(t-1) … of all t; 0 before the first sample."""
    columns = [(-data.y, i) for i in range(1, na + 1)] + [(data.u, i) for i in range(1, nb + 1)]
    return np.column_stack([np.concatenate([np.zeros(i), x[:-i]]) for x, i in columns])


@dataclass(frozen=True)
class MapError:
    """Errors of a map at points that it has not seen, l/min."""

    rmse: float
    largest: float


def air_valve_error(valve: Samples, estimator: Estimator) -> MapError:
    """Teach with every other point, swept up and down; verify with the points between."""
    state, _ = estimator.update(estimator.initial_state(), air_valve_swept(valve))
    between = valve[np.arange(len(valve)) % 2 == 1]
    error = between.Q - estimator.predict(state, between.U, between.dp, between.T)[0]
    return MapError(rmse(error), float(np.abs(error).max()))


def air_valve_swept(valve: Samples) -> Samples:
    """Every other point, swept up and down, a second apart."""
    taught = np.arange(0, len(valve), 2)
    rows = np.tile(np.concatenate([taught, taught[::-1]]), SWEEPS)
    t = np.arange(len(rows), dtype=np.int64) * SECOND
    return Samples.of(t, valve.U[rows], valve.p1[rows], valve.p2[rows], valve.Q[rows])
