"""Detection of U that reacts to the noise of the same sample, or is noisy: both bias a map.

The second difference of U, w = U(t) - 2·U(t-1) + U(t-2), is independent of the new part of the
residual, v(t) = e(t) - e(t-1), unless U reacts to the noise. For a smooth U plus a part
proportional to the noise, their correlation r is .87 in white noise, and .69 in noise with lag-1
correlation .95. Its correlation with v(t-1) is then equal; for a controller that answers the
previous sample, it is three times as large as with v(t). A misfit cancels in v.

The test compares the signs of w and v, whose mean product is 2/π·asin(r) for any amplitude. A few
large values, where U turns ahead of a slow meter, therefore do not dominate. Samples with a
negligible w are ignored. Jitter of U that the valve does not follow, with f'·σ_U > .6 σ_Q, has the
same effect and is detected. A U that consists of jitter only, such as random points before a slow
meter, is excluded, since its jitter is not small against its travel.
"""

import numpy as np

from valvemap.model.kernels.compiled import inlined, kernel
from valvemap.model.samples import Floats

# Offsets from the first one.
LAST_U, BEFORE_U, LAST_E, LAST_V, AGREED, AGREED_BEFORE, JITTERY, SEEN = range(8)
JITTER, MEAN_U, WAY = 8, 9, 10  # mean of |w|, of U; travel of U from that, %
PLACES = 11

MEMORY = 2000.0  # samples; memory of the means: r is accurate to .04
FEWEST = 500.0  # samples before the first verdict
LEAST = 0.05  # %: smaller jitter is ignored, and causes no bias
OFTEN = 0.3  # share of samples with jitter from which U is noisy
REACTS = 0.3  # mean product of the signs over those: r = .45
AT_ONCE = 0.6  # minimum ratio of the correlations with v(t) and v(t-1)
SMALL = 0.2  # limit of jitter over travel: random points held for two samples have .3 to .7
WAY_KEPT = 1.0 - 1e-5  # decay per sample: a machine at rest still has jitter


def weigh(s: Floats, g: int, U: float, e: float) -> None:
    """Add a sample, U in %; written from offset ``g`` on."""
    seen = s[g + SEEN] + 1.0
    part = 1.0 / min(seen, MEMORY)
    w = U - 2.0 * s[g + LAST_U] + s[g + BEFORE_U]
    v = e - s[g + LAST_E]
    jitter, agreed, before = 0.0, 0.0, 0.0
    if seen > 2.0 and abs(w) > LEAST and v != 0.0:
        jitter = abs(w)
        agreed = 1.0 if (w > 0.0) == (v > 0.0) else -1.0
        before = 1.0 if (w > 0.0) == (s[g + LAST_V] > 0.0) else -1.0
    s[g + AGREED] += part * (agreed - s[g + AGREED])
    s[g + AGREED_BEFORE] += part * (before - s[g + AGREED_BEFORE])
    s[g + JITTERY] += part * (abs(agreed) - s[g + JITTERY])
    s[g + JITTER] += part * (jitter - s[g + JITTER])
    s[g + MEAN_U] += part * (U - s[g + MEAN_U])
    s[g + WAY] = max(WAY_KEPT * s[g + WAY], abs(U - s[g + MEAN_U]))
    s[g + LAST_V] = v
    s[g + BEFORE_U] = s[g + LAST_U]
    s[g + LAST_U] = U
    s[g + LAST_E] = e
    s[g + SEEN] = min(seen, MEMORY)


weigh_in = inlined(weigh)


@kernel
def weighed(U: Floats, e: Floats) -> Floats:
    """Return the statistics (11,) after samples (N,)."""
    state = np.zeros(PLACES)
    for i in range(len(U)):
        weigh_in(state, 0, U[i], e[i])
    return state


def reacts(states: Floats, g: int) -> np.ndarray:
    """Whether U reacts, for states (..., places) with their statistics from offset ``g`` on."""
    share = states[..., g + JITTERY]
    known = (states[..., g + SEEN] >= FEWEST) & (share >= OFTEN)
    now, before = np.abs(states[..., g + AGREED]), np.abs(states[..., g + AGREED_BEFORE])
    small = states[..., g + JITTER] < SMALL * share * states[..., g + WAY]
    return np.asarray(known & small & (now > REACTS * share) & (now > AT_ONCE * before))
