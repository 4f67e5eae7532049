"""A small plant for tests of the stream: samples, and the data changes that carry them."""

import numpy as np

from valvemap.model.samples import Samples
from valvemap.pipeline.data_changes import DataChanges

START = 1_800_000_000_000_000_000


def plant(n, seed=1, first=0):
    """N scattered samples of Q = 3 + 0.1·U·√dp - 0.02·dp + noise, 100 Hz."""
    rng = np.random.default_rng(seed)
    U, dp = rng.uniform(0, 100, n), rng.uniform(0, 200, n)
    Q = 3 + 0.1 * U * np.sqrt(dp) - 0.02 * dp + rng.normal(0, 0.3, n)
    t = START + (first + np.arange(n)) * 10_000_000
    return Samples.of(t=t, U=U, p1=np.full(n, 200.0), p2=200 - dp, Q=Q, T=np.full(n, 40.0))


def lively(k, valve):
    """Sample k at 100 Hz of a valve that is never still; one flow in fifty is a spike."""
    noise, t = np.random.default_rng((valve, k)).normal(0, 0.3), 0.01 * k
    U = 50 + 30 * np.sin(0.9 * t + valve) + 12 * np.sin(2.3 * t)
    dp = 100 + 50 * np.sin(0.4 * t + 1)
    Q = 3 + 0.1 * U * np.sqrt(dp) - 0.02 * dp + noise + (90.0 if k % 50 == 17 else 0.0)
    return [float(x) for x in (U, 200.0, 200.0 - dp, Q, 40.0)]


def as_changes(samples):
    """The same samples as a server would notify them, sample by sample, with running numbers."""
    n = len(samples)
    columns = [samples.U, samples.p1, samples.p2, samples.Q, samples.T, np.arange(n)]
    return DataChanges(
        item=np.tile(np.arange(6, dtype=np.int32), n),
        value=np.stack(columns, axis=1).ravel(),
        status=np.zeros(6 * n, np.uint32),
        source_time=np.repeat(samples.t, 6),
    )
