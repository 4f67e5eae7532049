"""Whether U reacts to the noise of the same sample, or is itself as noisy: both bias a map.

What nobody could expect of U, w = U(t) - 2·U(t-1) + U(t-2), knows nothing of what is new of the
residual, v(t) = e(t) - e(t-1), unless U reacts to the noise. Where U is smooth but for a part that
goes with it, their correlation r is .87 in white noise, and .69 at one of .95 from sample to
sample. With v(t-1) it is the same then; a controller that answers the sample before goes three
times as much with v(t-1) as with v(t). A misfit cancels in v.

So the signs of w and v are compared, which agree by 2/π·asin(r) on the mean, whatever their size:
few large ones, where U turns before a slow meter, do not count for more. Samples whose w is next
to nothing do not count. Jitter of U's own that the valve does not see, with f'·σ_U > .6 σ_Q, shows
the same. So does a U whose way is all jitter, as of points drawn anew, behind a slow meter: that is
no reaction, and jitter is small beside the way of U.
"""

import numpy as np

from valvemap.model.kernels.compiled import inlined, kernel
from valvemap.model.samples import Floats

# Places, from a first one on.
LAST_U, BEFORE_U, LAST_E, LAST_V, AGREED, AGREED_BEFORE, JITTERY, SEEN = range(8)
JITTER, MEAN_U, WAY = 8, 9, 10  # mean of |w|, of U; how far U went from that, %
PLACES = 11

MEMORY = 2000.0  # samples that the means remember: r is known to .04
FEWEST = 500.0  # samples before which nothing is said
LEAST = 0.05  # %: less is no jitter of U, and biases nothing
OFTEN = 0.3  # share of samples with jitter from which on U jitters
REACTS = 0.3  # mean of the signs' product, over those: r = .45
AT_ONCE = 0.6  # of what goes with v(t-1) must go with v(t)
SMALL = 0.2  # of the way of U: points drawn anew, held for two samples, have .3 to .7
WAY_KEPT = 1.0 - 1e-5  # from sample to sample: a machine at rest has jitter still


def weigh(s: Floats, g: int, U: float, e: float) -> None:
    """Take a sample in, U in %; written from place ``g`` on."""
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
    """Places (11,) after samples (N,)."""
    state = np.zeros(PLACES)
    for i in range(len(U)):
        weigh_in(state, 0, U[i], e[i])
    return state


def reacts(states: Floats, g: int) -> np.ndarray:
    """Whether U reacts, of states (..., places) whose reaction stands from place ``g`` on."""
    share = states[..., g + JITTERY]
    known = (states[..., g + SEEN] >= FEWEST) & (share >= OFTEN)
    now, before = np.abs(states[..., g + AGREED]), np.abs(states[..., g + AGREED_BEFORE])
    small = states[..., g + JITTER] < SMALL * share * states[..., g + WAY]
    return np.asarray(known & small & (now > REACTS * share) & (now > AT_ONCE * before))
