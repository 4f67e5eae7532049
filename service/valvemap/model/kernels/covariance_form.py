"""Operations on P = U·D·Uᵀ besides the step: forgetting, and opening after a change."""

import numpy as np

from valvemap.model.kernels.compiled import inlined
from valvemap.model.kernels.place_layout import PROVEN
from valvemap.model.kernels.place_visits import LONGEST
from valvemap.model.kernels.row_layout import (
    COUNT,
    HASTE,
    LAST_Z,
    LATELY,
    OPENED,
    SCALE,
    SCALE_WEIGHT,
    SQUARES,
    TRACE,
    VARIANCE,
    WEIGHT,
    Counts,
    Places,
    Size,
)
from valvemap.model.kernels.rules import TRACE_LIMIT, VARIABLE, Rule
from valvemap.model.kernels.triangles import add_rank_one, inform, rotate, scaled_trace
from valvemap.model.samples import Floats

SETTLED = 20.0
GOLDEN = 40503  # golden section of 65536
FLOOR = 1e-4  # minimum information along X after forgetting, in squared scaled units
CLIP = 4.0  # standard deviations at which an innovation is clipped
SCALE_WINDOW = 1.0 / 1000.0  # per sample; window of the mean square used as unit
POWER_WINDOW = 1.0 / 200.0  # per sample; window of the recent mean square
LEAST_POWER = 0.1  # minimum of the recent mean square, in that unit
TOLERATED = 0.4  # correlation of consecutive innovations that coloured noise may cause
HASTE_STEP = 0.005  # per sample
OPENING = 10.0  # a changed plant: earlier samples get the weight of a tenth of a sample


@inlined
def pace(size: Size, s: Floats, at: Places, rule: Rule) -> float:
    """Return the current λ; during drift 1 - λ is n-fold, since a step forgets along X only."""
    if rule.threshold == np.inf:
        return rule.lam
    haste = s[at.detector + HASTE]
    if rule.lam < 1.0:
        return float(1.0 - (1.0 - rule.lam) * np.exp(haste))
    return float(1.0 - len(size) * np.exp(haste) / LONGEST) if haste > PROVEN else 1.0


@inlined
def hurry(s: Floats, at: Places, rule: Rule, e: float, square: float) -> None:
    """For a plant known to drift: forget faster while innovations are coloured.

    ``square``: e² over its variance in units of σ².
    """
    g = at.detector
    z = 0.0
    if s[g + SCALE] > 0.0:
        z = np.copysign(min(np.sqrt(square / s[g + SCALE]), CLIP), e)
    settled = s[g + SCALE_WEIGHT] > SETTLED
    if settled:
        square = min(square, 9.0 * s[g + SCALE])
    s[g + SCALE_WEIGHT] += 1.0 - SCALE_WINDOW * s[g + SCALE_WEIGHT]
    s[g + SCALE] += (square - s[g + SCALE]) / s[g + SCALE_WEIGHT]
    if settled:
        s[g + LATELY] += POWER_WINDOW * (z * z - s[g + LATELY])
        colour = z * s[g + LAST_Z] / max(s[g + LATELY], LEAST_POWER)
        haste = s[g + HASTE] + HASTE_STEP * (colour - TOLERATED)
        s[g + HASTE] = min(max(haste, 0.0), rule.most)
        s[g + LAST_Z] = z


@inlined
def note(s: Floats, at: Places, thetas: Floats, i: int, n: int) -> None:
    """Write theta after sample i if requested."""
    if i < len(thetas):
        for j in range(n):
            thetas[i, j] = s[at.theta + j]


@inlined
def learn_noise(s: Floats, at: Places, kind: int, lam: float, square: float) -> None:
    """Update σ² with an innovation; ``square`` is its square over its variance in units of σ²."""
    weight = lam * s[at.noise + WEIGHT] + 1.0
    variance = s[at.noise + VARIANCE]
    s[at.noise + WEIGHT] = weight
    s[at.noise + SQUARES] = lam * lam * s[at.noise + SQUARES] + 1.0
    if kind == VARIABLE and weight > SETTLED:  # jumps of λ must not raise σ²
        square = min(square, 9.0 * variance)
    s[at.noise + VARIANCE] = variance + (square - variance) / weight


@inlined
def variable_lam(s: Floats, at: Places, rule: Rule, e: float, r: float) -> float:
    """Return λ of `Variable`, which decreases with the innovation."""
    variance = s[at.noise + VARIANCE]
    if s[at.noise + WEIGHT] <= SETTLED or variance <= 0.0:
        return rule.lam
    return float(max(rule.least, 1.0 - (1.0 - rule.lam) * e * e / ((1.0 + r) * variance)))


@inlined
def weight_along(size: Size, s: Floats, at: Places, lam: float, r: float) -> float:
    """Weight of a sample that forgets along X; 1 if the information there is at its floor."""
    length = 0.0
    for j in range(len(size)):
        length += (s[at.x + j] * s[at.unit + j]) ** 2
    return 1.0 - (1.0 - lam) / r if length > FLOOR * r else 1.0


@inlined
def is_nth(count: int, n: int) -> bool:
    """Whether a sample is one of every ``n``: equidistributed, aperiodic."""
    return (count * GOLDEN & 0xFFFF) * n <= 0xFFFF


@inlined
def grows_beyond_limit(size: Size, s: Floats, at: Places, lam: float, r: float) -> bool:
    """Whether division by λ would increase a P beyond its limit."""
    n = len(size)
    trace = scaled_trace(size, s, at.factor, at.scale)
    s[at.noise + TRACE] = trace
    if trace <= TRACE_LIMIT:
        return False
    p = at.factor
    for j in range(n):
        v = s[p + j] * s[at.f + j]
        s[at.Px + j] = v
        for k in range(j):
            s[at.Px + k] += s[p + k] * v
        p += j + 1
    lost = 0.0
    for j in range(n):
        lost += (s[at.Px + j] * s[at.scale + j]) ** 2
    return bool((trace - lost / (lam + r)) / lam > trace)


@inlined
def forget_subspace(size: Size, s: Floats, at: Places, lam: float) -> None:
    """P ← P + (1 - λ)/λ·vvᵀ/(vᵀP⁻¹v), v = X in the units of theta."""
    length = 0.0
    for j in range(len(size)):
        s[at.Px + j] = s[at.x + j] * s[at.unit + j] * s[at.unit + j]
        length += s[at.Px + j] * s[at.x + j]
    information = inform(size, s, at.factor, at.Px, at.g)
    if length > FLOOR and information > FLOOR * length:
        taken = (1.0 - lam) / information
        rotate(size, s, at.spread, at.g, at.Px, at.f, taken, taken * lam)
        add_rank_one(size, s, at.factor, at.Px, taken / lam)


@inlined
def let_go(size: Size, s: Floats, at: Places, counters: Counts, lam: float) -> None:
    """Reduce the weight of all samples before a change to nearly 0."""
    n = len(size)
    samples = float(counters[COUNT] - counters[OPENED])
    growth = OPENING * (min(1.0 / (1.0 - lam), samples) if lam < 1.0 else samples)
    counters[OPENED] = counters[COUNT]
    trace = scaled_trace(size, s, at.factor, at.scale)
    growth = min(growth, max(1.0, TRACE_LIMIT / trace)) if trace > 0.0 else growth
    p = at.factor
    for j in range(n):
        s[p + j] *= growth
        p += j + 1
    for p in range(n * (n + 1) // 2):
        s[at.spread + p] /= growth
