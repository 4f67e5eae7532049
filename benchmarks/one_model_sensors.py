"""Rows of `benchmarks.one_model` in which the sensors are at fault; the map asked is the valve's.

An offset that drifts begins after 100 s and ends at the end; one that jumps does so then.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from benchmarks import circumstances as c
from benchmarks.one_model_rows import Row, disturbed, plain
from valvemap.vocabulary.findings import FindingCode

BEGINS: Final = 10_000  # samples
OF_Q, OF_DP = FindingCode.FLOW_ZERO, FindingCode.PRESSURE_ZERO
AT_END: Final = 180.0  # l/min; what a meter shows that stands at its end


def offset(name, seed, N=40_000, how="drifts", of_Q=0.0, of_dp=0.0, per_hour=0.0, causes=()):
    """Offsets of the flow (l/min) and of Δp (bar) that drift or jump; a gain that drifts."""
    row, valve = plain(name, "cycle", N, seed), c.VALVES[name]
    U, dp, since = row.samples.U, row.samples.dp, np.arange(N) - BEGINS
    share = np.clip(since / (N - BEGINS), 0.0, 1.0) if how == "drifts" else 1.0 * (since >= 0)
    gain = 1.0 + per_hour * np.arange(N) / c.FS / 3600.0
    Q = gain * valve(U, dp) + of_Q * share + c.white(seed, N)
    truth = partial(_times, valve, float(gain[-1]))
    return Row(c.samples_of(U, dp + of_dp * share, Q), (N,), (truth,), causes=frozenset(causes))


def _times(valve, factor, U, dp):
    return factor * valve(U, dp)


def grown(name, factor, seed, N=20_000, at=10_000):
    """Noise that is ``factor`` times as large from sample ``at`` on."""
    row = plain(name, "cycle", N, seed)
    noise = c.white(seed, N) * np.where(np.arange(N) < at, 0.0, factor - 1.0)
    return replace(row, samples=replace(row.samples, Q=row.samples.Q + noise))


def stands_at_end(Q, first, samples=300):
    """A meter that shows its end for a while."""
    Q[first : first + samples] = AT_END


def trembles_at_end(Q, first, samples=300):
    """The same with the noise of a meter."""
    Q[first : first + samples] = AT_END + 0.4 * np.random.default_rng(first).normal(size=samples)


def shows_anything(Q, first, samples=200):
    """A meter that shows anything."""
    Q[first : first + samples] = np.random.default_rng(first).uniform(0.0, AT_END, samples)


def shows_half(Q, first, samples=200):
    """A meter that shows half of the flow for a while, as with one of two pulses lost."""
    Q[first : first + samples] *= 0.5


FAILS: Final = {
    "meter stands at its end for 3 s": stands_at_end,
    "meter trembles at its end for 3 s": trembles_at_end,
    "meter stands at its end for 20 s": partial(stands_at_end, samples=2_000),
    "meter shows anything for 2 s": shows_anything,
    "meter shows half for 2 s": shows_half,
}
OFFSETS: Final[Mapping[str, dict]] = {
    "Q's zero drifts by 3 l/min": {"how": "drifts", "of_Q": 3.0, "causes": (OF_Q,)},
    "Q's zero jumps by 3 l/min": {"how": "jumps", "of_Q": 3.0, "causes": (OF_Q,)},
    "dp's zero drifts by 6 bar": {"how": "drifts", "of_dp": 6.0, "causes": (OF_DP,)},
    "dp's zero jumps by 6 bar": {"how": "jumps", "of_dp": 6.0, "causes": (OF_DP,)},
    "both zeros drift": {"how": "drifts", "of_Q": 3.0, "of_dp": -6.0, "causes": (OF_Q, OF_DP)},
    "Q's zero drifts, gain -60 %/h": {
        "how": "drifts",
        "of_Q": -3.0,
        "per_hour": -0.6,
        "causes": (FindingCode.GAIN_DRIFT, OF_Q),
    },
}
SENSORS: Final[Mapping[str, Callable[[int], Row]]] = {
    **{
        f"{what}, {name}": partial(offset, name, **how)
        for what, how in OFFSETS.items()
        for name in ("ordinary", "S-shape")
    },
    **{
        f"{what}, {name}": partial(disturbed, name, how)
        for what, how in FAILS.items()
        for name in ("ordinary", "S-shape")
    },
    **{
        f"noise grows {factor} times, {name}": partial(grown, name, factor)
        for factor in (3, 5)
        for name in ("ordinary", "S-shape")
    },
}
