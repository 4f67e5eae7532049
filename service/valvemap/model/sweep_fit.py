r"""The flow curve of a valve from a sweep of its signal: map, hysteresis and lag together.

The spool's position x follows U through a play of width h and a lag of first order, and

$$Q = \frac{h(s)}{h(s_r)} K(x) + \delta L(x) + \delta^2 M(x), \qquad \delta = \frac{s - s_r}{s_r},
\qquad s = \operatorname{sign}(\Delta p)\sqrt{|\Delta p|},$$

where K, a knot per 1 % of U, is the curve at the rated pressure drop s_r², h the law of the
pressure drop that all openings share (`sweep_law`), and L and M, a knot per 12 %, are what single
openings depart from it. Samples count the less, the further their Δp is from the
rated one: how fast, the likelihood decides, so that all count alike where the equation holds at all
pressure drops. All three are piecewise linear and smooth: the bends of each have a Student
distribution, so that the edge of a dead band may bend sharply, of a scale that the marginal
likelihood decides; so are the sizes of L and M, which vanish where all openings share the law.

Q is linear in the coefficients, which are eliminated at every step of the search for h and the lag
(variable projection). Where U always moves at the same pace, play and lag look alike but for the
turning points; so the lag has a prior, of a usual spool and meter. The covariance of all of them at
the optimum, times what the residuals have in common from sample to sample, gives a Gaussian
posterior; figures are computed of draws from it. A weight w multiplies a sample's noise as well:
the covariance is H⁻¹JH⁻¹, with H the information of the weighted samples and J that of their noise.
"""

from typing import Final

import numpy as np
from scipy import optimize

from valvemap.model.samples import Floats, Samples
from valvemap.model.sweep_equations import Problem, SweepFit
from valvemap.vocabulary.statuses import Quality

FEWEST: Final = 500  # samples; less tell no curve
PLAYS: Final = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)  # %; where the search begins
LAGS: Final = (0.0, 0.02, 0.1)  # s; the same of the lag
MOST_PLAY, MOST_LAG = 25.0, 1.0  # %, s; limits of the search
ROUNDS: Final = 4  # of their weights


def usable(samples: Samples) -> Samples:
    """Return the samples that are not Bad and have U, Δp and Q."""
    finite = np.isfinite(samples.Q) & np.isfinite(samples.U) & np.isfinite(samples.dp)
    return samples[(samples.quality != Quality.BAD) & finite]


def fit_sweep(samples: Samples, dp_rated: float, U_grid: Floats, seed: int = 0) -> SweepFit | None:
    """Fit the samples of one valve.

    Parameters
    ----------
    samples
        Those that are `usable`; at least `FEWEST`.
    dp_rated
        Pressure drop for which the flow curve is given, bar.
    U_grid
        Positions of the spool for which it is given, %, (G,), ascending.
    seed
        Of the draws.

    Returns
    -------
    SweepFit
        None if there are too few samples, U does not move, or the equations cannot be solved.

    Examples
    --------
    >>> from valvemap.model.sweep_equations import spool
    >>> t = np.arange(2000)
    >>> U = 100 * np.abs((t / 500) % 2 - 1)
    >>> x, rng = spool(U, np.full(2000, 0.01), 2.0, 0.0), np.random.default_rng(0)
    >>> Q = 0.1 * x * np.sqrt(70) + rng.normal(0, 0.2, 2000)
    >>> samples = Samples.of(t=t * 10**7, U=U, p1=0 * U + 70, p2=0 * U, Q=Q)
    >>> found = fit_sweep(samples, 70.0, np.array([20.0, 50.0, 80.0]))
    >>> round(found.play, 1), found.Q.round(0)
    (2.0, array([17., 42., 67.]))
    """
    if len(samples) < FEWEST:
        return None
    problem = Problem(samples, dp_rated, U_grid)
    at = min(((p, g) for p in PLAYS for g in LAGS), key=problem.cost)
    at = _searched(problem, at)
    for _ in range(ROUNDS):
        problem.fit_law(*at)
        problem.weigh_drops(*at)
        problem.weigh_bends(*at)
    return problem.posterior(*_searched(problem, at), U_grid, seed)


def _searched(problem: Problem, start: tuple[float, float]) -> tuple[float, float]:
    """Return play and lag of the least cost near ``start``."""
    found = optimize.minimize(
        problem.cost,
        np.array(start),
        method="Nelder-Mead",
        bounds=((0.0, MOST_PLAY), (0.0, MOST_LAG)),
        options={
            "xatol": 1e-3,
            "fatol": 1e-3,
            "initial_simplex": np.array(start) + np.array([[0, 0], [0.3, 0], [0, 0.01]]),
        },
    )
    return float(found.x[0]), float(found.x[1])
