"""The erratum of recursive maximum likelihood, eq. (29), on the standard ARMAX example."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from scipy.signal import lfilter

from paper.erratum import Erratum
from valvemap.model.armax import recursive_maximum_likelihood
from valvemap.model.samples import Floats

A, B, D = [1.0, -1.5, 0.7], [0.0, 1.0, 0.5], [1.0, -1.0, 0.2]
TRUTH: Final = np.array([-1.5, 0.7, 1.0, 0.5, -1.0, 0.2])
RUNS, N, P0 = 60, 2000, 100.0
CLOSE = 0.5


def of_maximum_likelihood() -> Iterator[Erratum]:
    """Evaluate the erratum of eq. (29)."""
    data = [_armax(seed) for seed in range(RUNS)]
    y, u = (np.stack([each[i] for each in data]) for i in (0, 1))
    right = np.array([recursive_maximum_likelihood(*each, 2, 2, 2, p0=P0).theta for each in data])
    yield Erratum(
        "(29)",
        "innovation ε fed back, no stability of D(q), no schedule of λ",
        "residual after the update fed back, D(q) kept stable, λ rising from 0.95, small P₀ of d",
        f"share of {RUNS} runs of Åström's example (N = {N:,}, σ = 1, P₀ = {P0:g}) in which a "
        f"parameter ends more than {CLOSE:g} off",
        _share_off(_printed(y, u)),
        _share_off(right),
        0.0,
        "an estimator that fails in some runs cannot run unattended",
    )


def _armax(seed: int) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(seed)
    u, v = rng.choice(np.array([-1.0, 1.0]), N), rng.normal(size=N)
    return lfilter(B, A, u) + lfilter(D, A, v), u


def _share_off(theta: Floats) -> float:
    return float((~(np.abs(theta - TRUTH) <= CLOSE).all(axis=1)).mean())


def _printed(y: Floats, u: Floats) -> Floats:
    """Return theta (R, 6) of eq. (29) as printed, for R runs in parallel."""
    runs = len(y)
    theta, P = np.zeros((runs, 6)), np.tile(P0 * np.eye(6), (runs, 1, 1))
    raw, filtered = np.zeros((runs, 3, 2)), np.zeros((runs, 3, 2))  # y, u, ε at t-1, t-2
    signs = np.array([[[-1.0], [1.0], [1.0]]])
    with np.errstate(all="ignore"):
        for t in range(y.shape[1]):
            h, h_f = ((memory * signs).reshape(runs, 6) for memory in (raw, filtered))
            g = np.einsum("sij,sj->si", P, h_f)
            L = g / (1.0 + np.sum(h_f * g, axis=1))[:, None]
            innovation = y[:, t] - np.sum(h * theta, axis=1)
            theta = theta + L * innovation[:, None]
            P = P - L[:, :, None] * g[:, None, :]
            now = np.stack([y[:, t], u[:, t], innovation], axis=1)
            now_filtered = now - np.einsum("sk,sck->sc", theta[:, 4:], filtered)
            raw = np.stack([now, raw[:, :, 0]], axis=2)
            filtered = np.stack([now_filtered, filtered[:, :, 0]], axis=2)
    return theta
