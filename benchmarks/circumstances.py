"""Valves and circumstances on which maps must stay honest, and what "honest" is measured by.

Units: U in %, dp and p in bar, Q in l/min, T in °C, t in s at ``FS`` Hz; ``SIGMA`` is the noise of
Q. *Inside* is within 5 % of U and 5 bar of at least three samples.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from valvemap.model.model_structures import FiveTerms
from valvemap.model.samples import Samples

SIGMA, FS = 0.4, 100.0
TWO_SIDED_95 = 1.959964
THETA = np.array([1.0, 0.02, 0.3, 0.12, -0.01])

Valve = Callable[..., np.ndarray]


def eq7(U, dp):
    """Exactly eq. (7)."""
    return eq7_of(THETA)(U, dp)


def eq7_of(theta):
    """A valve that is eq. (7) with other parameters."""

    def valve(U, dp):
        s = np.sqrt(np.abs(dp))
        return theta[0] + theta[1] * U + theta[2] * s + theta[3] * U * s + theta[4] * dp

    return valve


def ordinary(U, dp):
    """A dead band of 4 %, a gain that bends slightly."""
    u = np.clip((U - 4.0) / 96.0, 0.0, 1.0)
    return 14.0 * u * (1.15 - 0.15 * u) * np.sign(dp) * np.sqrt(np.abs(dp))


def dead_band(U, dp, width=8.0):
    """A dead band: eq. (7) misfits."""
    u = np.clip((U - width) / (100.0 - width), 0.0, None)
    return 14.0 * u * (1.0 - 0.1 * u**2) * np.sqrt(dp)


def s_shape(U, dp):
    """An S-shaped gain: eq. (7) misfits more."""
    u = U / 100.0
    return 14.0 * (3.0 * u**2 - 2.0 * u**3) * np.sqrt(dp) * (1.0 - 4e-4 * dp)


def saturating(U, dp):
    """A gain that bends all the way."""
    return 9.0 * np.tanh(U / 45.0) * np.sqrt(dp)


def laminar(U, dp):
    """Laminar at small dp, turbulent above."""
    return 14.0 * (U / 100.0) ** 1.3 * (np.sqrt(np.abs(dp) + 2.25) - 1.5)


def two_slopes(U, dp, knee=40.0):
    """A metering edge of two slopes."""
    return (0.06 * U + 0.09 * np.clip(U - knee, 0.0, None)) * np.sqrt(dp)


def progressive(U, dp, power=1.7):
    """A progressive gain, without a dead band."""
    return 13.0 * (U / 100.0) ** power * np.sqrt(dp)


VALVES = {
    "eq. (7)": eq7,
    "ordinary": ordinary,
    "dead band": dead_band,
    "S-shape": s_shape,
    "saturating": saturating,
    "laminar": laminar,
    "two slopes": two_slopes,
    "progressive": progressive,
}


def warm(valve, k=2e-3):
    """The same valve with a flow that rises by k per degree."""
    return lambda U, dp, T=40.0: valve(U, dp) * (1.0 + k * (T - 40.0))


def warming(N, low=40.0, high=60.0, tau=1200.0):
    """Temperature of a machine that warms up."""
    return high - (high - low) * np.exp(-np.arange(N) / FS / tau)


def scattered(seed, N, U=(0.0, 100.0), dp=(2.0, 198.0)):
    """U and dp drawn for every sample."""
    rng = np.random.default_rng(seed)
    return rng.uniform(*U, N), rng.uniform(*dp, N)


def structured(levels=21, per_level=600, dp=(1.0, 199.0)):
    """U in rising levels, dp swept up and down at each."""
    sweep = np.linspace(*dp, per_level // 2)
    U = np.repeat(np.linspace(0.0, 100.0, levels), per_level)
    return U, np.tile(np.concatenate([sweep, sweep[::-1]]), levels)


def ramps_and_holds(rng, N, low, high, shortest=0.4, longest=3.0):
    """What a machine does: ramps between random levels, held in between."""
    t, x = [0.0], [rng.uniform(low, high)]
    while t[-1] < N / FS:
        ramp, level = rng.uniform(shortest, longest), rng.uniform(low, high)
        t += [t[-1] + ramp, t[-1] + ramp + rng.uniform(0.0, 1.0)]
        x += [level, level]
    return np.interp(np.arange(N) / FS, t, x)


def cycle(seed, N, U=(0.0, 100.0), dp=(3.0, 195.0)):
    """U and dp along independent ramps and holds."""
    return tuple(
        ramps_and_holds(np.random.default_rng([seed, k]), N, *range_)
        for k, range_ in enumerate((U, dp))
    )


def white(seed, N, sigma=SIGMA):
    """White noise."""
    return sigma * np.random.default_rng([seed, 2]).normal(size=N)


def ar(seed, N, rho=0.95, sigma=SIGMA):
    """Stationary AR(1) noise of standard deviation sigma."""
    e = white(seed, N, sigma)
    e[1:] *= np.sqrt(1.0 - rho**2)
    values = e.tolist()
    for i in range(1, N):
        values[i] += rho * values[i - 1]
    return np.array(values)


def lagged(x, tau):
    """Behind a first-order lag of time constant tau, s."""
    share = 1.0 - np.exp(-1.0 / (FS * tau)) if tau > 0.0 else 1.0
    out, y = np.empty(len(x)), x[0]
    for i, value in enumerate(x.tolist()):
        y += share * (value - y)
        out[i] = y
    return out


def drift(N, per_hour=-0.15):
    """Factor on Q of a gain that drifts."""
    return 1.0 + per_hour * np.arange(N) / FS / 3600.0


def worn_edge(U, dp, amount=0.5, below=15.0):
    """Flow that a metering edge worn near closed lets through more, l/min."""
    return amount * np.clip(1.0 - U / below, 0.0, 1.0) * np.sqrt(dp)


def wear(N, over=3600.0):
    """How far an edge is worn, from 0 to 1 within ``over`` s."""
    return np.clip(np.arange(N) / FS / over, 0.0, 1.0)


def reacting(U, noise, gain=1.0):
    """U that reacts to the noise of the same sample."""
    return np.clip(U - gain * noise, 0.0, 100.0)


def closed_loop(seed, N, valve, sigma=SIGMA):
    """U chosen by a PI controller from the noisy Q, dp free: U, dp, Q."""
    rng, noise = np.random.default_rng([seed, 3]), white(seed, N, sigma)
    dp, demand = ramps_and_holds(rng, N, 20.0, 180.0), ramps_and_holds(rng, N, 10.0, 120.0)
    U, Q, integral, u = np.empty(N), np.empty(N), 0.0, 20.0
    for i in range(N):
        Q[i] = float(valve(np.array([u]), dp[i : i + 1])[0]) + noise[i]
        U[i] = u
        integral += (demand[i] - Q[i]) / FS
        u = min(max(0.05 * (demand[i] - Q[i]) + 1.5 * integral, 0.0), 100.0)
    return U, dp, Q


def samples_of(U, dp, Q, T=40.0):
    """Samples at FS Hz; p2 is 0."""
    N = len(U)
    t = (np.arange(N) * (1e9 / FS)).astype(np.int64)
    return Samples.of(t, U, dp, np.zeros(N), Q, np.broadcast_to(np.float64(T), N))


@dataclass(frozen=True)
class Region:
    """Points (U, dp) at which a map is asked."""

    U: np.ndarray
    dp: np.ndarray

    @property
    def T(self):
        return np.full(len(self.U), 40.0)

    def rows(self):
        """Regressors of eq. (7)."""
        return FiveTerms().regressors(self.U, self.dp, self.T)


def inside(U, dp, grid=41):
    """Points of a grid within 5 % of U and 5 bar of at least three of the samples."""
    U0, dp0 = (x.ravel() for x in np.meshgrid(np.linspace(0, 100, grid), np.linspace(0, 200, grid)))
    # Boxes of a tenth of the distance: rounding moves the border by half of one.
    counts = np.histogram2d(U, dp, (201, 401), ((-0.25, 100.25), (-0.25, 200.25)))[0]
    total = np.zeros((202, 402))
    total[1:, 1:] = counts.cumsum(0).cumsum(1)
    i, j = np.round(U0 * 2).astype(int), np.round(dp0 * 2).astype(int)
    low_i, high_i = np.maximum(i - 10, 0), np.minimum(i + 11, 201)
    low_j, high_j = np.maximum(j - 10, 0), np.minimum(j + 11, 401)
    near = total[high_i, high_j] - total[low_i, high_j] - total[high_i, low_j] + total[low_i, low_j]
    return Region(U0[near >= 3], dp0[near >= 3])


def best_eq7(region, truth):
    """Eq. (7) fitted to a noise-free map over a region: theta, and the error that is left (RMS)."""
    X, Q = region.rows(), truth(region.U, region.dp)
    theta = np.linalg.lstsq(X, Q, rcond=None)[0]
    return theta, rms(X @ theta - Q)


def rms(x):
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(x))))
