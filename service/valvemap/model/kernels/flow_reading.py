"""Noise that grows with the reading: σ²(q) = σ²·n(q), n(q) = 1 + part·(q² - mean), 1 at least.

A meter's error is a constant and a share of the reading. The part follows from least squares of
squared errors over q², weighed by 1/n²: the variance of a square is 2·σ⁴·n². One that is not surely
above 0 is none. Where little flows, σ² stands: errors of the map and of cells are as large there.

The same numbers are kept of the rate dQ/dt in place of q: where the time of a sample is not known
to a part of a step, or its spool lags by that, it is off by as much as the flow changes then.
"""

import math

from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner
from valvemap.model.samples import Floats

# Places in the numbers of a valve: part, 1/(l/min)²; mean of q², (l/min)².
PART, MEAN = 0, 1
# Sums: of q²; of 1, q², q⁴, e² and e²·q² by weight.
SQUARES, WEIGHTS, OF_Q2, OF_Q4, OF_E2, OF_BOTH = range(2, 8)
NUMBERS = 8


@inner
def ratio(of: Floats, flow: float) -> float:
    """Variance of the noise at a flow, in usual ones."""
    return float(max(1.0 + of[PART] * (flow * flow - of[MEAN]), 1.0))


@inner
def note(of: Floats, kept: float, weight: float, square: float, flow: float) -> None:
    """Add the squared error of a sample, and keep ``kept`` of those before."""
    x, n = flow * flow, ratio(of, flow)
    w = weight / (n * n)
    for k in range(SQUARES, NUMBERS):
        of[k] *= kept
    of[SQUARES] += weight * x
    of[WEIGHTS] += w
    of[OF_Q2] += w * x
    of[OF_Q4] += w * x * x
    of[OF_E2] += w * square
    of[OF_BOTH] += w * square * x


@inner
def estimate(of: Floats, many: float, alike: float) -> None:
    """Estimate the part from ``many`` samples, ``alike`` of which weigh as much as one."""
    of[PART] = 0.0
    if many < rules.COLOUR_KNOWN:
        return
    of[MEAN], total = of[SQUARES] / many, of[WEIGHTS]
    across = total * of[OF_Q4] - of[OF_Q2] * of[OF_Q2]
    if not across > 1e-12 * total * of[OF_Q4]:
        return
    rise = (total * of[OF_BOTH] - of[OF_Q2] * of[OF_E2]) / across
    usual = (of[OF_E2] + rise * (total * of[MEAN] - of[OF_Q2])) / total
    if usual > 0.0 and rise > rules.SURE * usual * math.sqrt(2.0 * alike * total / across):
        of[PART] = rise / usual
