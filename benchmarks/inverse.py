"""How fast the inverse map is, warm, on one core: ``python -m benchmarks.inverse``.

Each structure answers 100,000 demands as arrays, U with its 95 % interval and status; the peer is
scipy's brentq through the same map's ``predict``, point by point. CPU time, the best of seven.
"""

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from valvemap.model.flow_map import FlowMap
from valvemap.model.forgetting import Adaptive
from valvemap.model.inverse_map import invert
from valvemap.model.recursive_least_squares import RecursiveLeastSquares
from valvemap.model.samples import Samples
from valvemap.model.tensor_spline import TensorSpline

POINTS, PEER_POINTS, ROUNDS = 100_000, 300, 7
MAPS = {
    "eq. (7)": RecursiveLeastSquares(),
    "spline, 63 parameters": RecursiveLeastSquares(TensorSpline.uniform(6, 4), Adaptive()),
    "Auto": FlowMap(),
}


def microseconds() -> dict[str, tuple[float, float]]:
    """By map: µs per point, and how many times that brentq takes."""
    rng = np.random.default_rng(0)
    U, dp = rng.uniform(0, 100, 5000), rng.uniform(1, 200, 5000)
    Q = 0.12 * U * np.sqrt(dp) + 0.4 * rng.normal(size=5000)
    samples = Samples.of(np.arange(5000), U, dp, 0 * dp, Q, np.full(5000, 40.0))
    demand, drop = rng.uniform(5, 60, POINTS), rng.uniform(50, 200, POINTS)
    found = {}
    for name, estimator in MAPS.items():
        state, _ = estimator.update(estimator.initial_state(), samples)
        ours = _best(lambda e=estimator, s=state: invert(e, s, demand, drop, 40.0)) / POINTS

        def root(k: int, e=estimator, s=state) -> float:
            def missing(u: float) -> float:
                return e.predict(s, *np.array([[u], [drop[k]], [40.0]]))[0][0] - demand[k]

            return brentq(missing, 0.0, 100.0)

        peer = _best(lambda r=root: [r(k) for k in range(PEER_POINTS)]) / PEER_POINTS
        found[name] = ours * 1e6, peer / ours
    return found


def _best(work: Callable[[], object]) -> float:
    work()
    times = []
    for _ in range(ROUNDS):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


if __name__ == "__main__":
    for name, (us, ratio) in microseconds().items():
        print(f"{name:24s} {us:6.2f} µs per point, brentq {ratio:6.0f} times as long")
