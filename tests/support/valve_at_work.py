"""Signals of a valve at work, as a recording has them."""

import numpy as np

N = 600


def valve_at_work():
    """t (s), U (%), p1, p2 (bar), Q (l/min)."""
    rng = np.random.default_rng(4)
    t = np.arange(N) * 0.05
    U = 50 + 30 * np.sin(0.9 * t) + 12 * np.sin(2.3 * t)
    p1, p2 = 180 - 0.1 * U, 40 + 25 * np.sin(0.7 * t)
    Q = 4 * (U / 100) ** 1.2 * np.sqrt(p1 - p2) + rng.normal(0, 0.2, N)
    return {"t": t, "U": U, "p1": p1, "p2": p2, "Q": Q}
