"""What the valve did at each place: a memory of flows over (U, √dp) that knows no structure.

A grid of nodes; node k holds the flow v that was measured there, whatever the structure makes of
it. Of the structure the slopes alone are used, to carry a sample to the nodes around it: what
earlier visits lead to expect of the residual is c = Σ φₖ·(vₖ - Xₖᵀtheta), φ bilinear. So

- e = c + d: the innovation e is what the place is known for, c, and what is new, d;
- c is misfit of the structure: it comes back as long as the plant stays;
- d is noise as long as the plant stays, whether the structure fits or not.

A node's flow is a running mean, with the gain of a Kalman filter whose covariance is diagonal. What
is known of it fades with time. The mean moves by less than single precision tells of a flow; of all
else that is kept of a node single precision tells enough.

Drift is told from noise and misfit by visits: d averaged over a visit to a node, times the same of
the visit before. Noise of visits that lie apart is independent, however coloured it is, and misfit
is not in d; what is left on the average is the square of the way by which the memory lags behind.
Where that is more than TOLERATED, what is known of the nodes fades faster, and so does what theta
rests on, yet no faster than places are seen again; and theta is fitted anew to what the nodes hold:
each place counts with what it showed last, and none is lost.
"""

from typing import NamedTuple

import numpy as np

from valvemap.model.kernels.compiled import inlined, inner, maker
from valvemap.model.kernels.factors import back_substitute, independence, rotate_in
from valvemap.model.kernels.information_form import INDEPENDENT, settle
from valvemap.model.kernels.row_layout import (
    AWAY,
    BEND,
    CARRIED,
    CLOCK,
    CLOSED,
    COMMON,
    COMMON_WEIGHT,
    COUNT,
    FADING,
    FLOOR,
    GAP,
    HASTE,
    LAG,
    LAST_E,
    LAST_MEAN,
    LOCAL,
    LOOKED_AT,
    MISFIT,
    MISFIT_POWER,
    NEW,
    NODE,
    POWER,
    POWER_WEIGHT,
    PRODUCT,
    REST_A,
    REST_B,
    RESTED,
    REVISITED,
    SQUARE,
    SUSPECTED,
    SWEPT,
    VARIANCE,
    VISIT_BEGAN,
    VISIT_COMMON,
    VISIT_LENGTH,
    VISIT_POWER,
    VISIT_SQUARES,
    VISIT_SUM,
    VISIT_WEIGHT,
    Counts,
    Places,
    Size,
    places_of,
)
from valvemap.model.kernels.rules import Rule
from valvemap.model.kernels.triangles import whiten
from valvemap.model.samples import Codes, Floats, Singles

# Fields of a node in `places`: samples that its flow is the mean of; time by the clock when it was
# touched last; mean square of d around it; mean of d over the last visit; end of that visit.
KNOWN, TOUCHED, SPREAD, DEVIATION, VISITED = range(5)
FIELDS = 5
# In `visits`: how many since the plant changed, or MANY; looks of the last one.
VISITS, STAYED = range(2)
FIELDS_OF_VISITS = 2
MANY = 255

NODES_A, NODES_B = 17, 12  # of the grid, along U and √dp
TOP_DP = 225.0  # bar: the last node

SETTLED = 20  # samples after theta was determined before a place is remembered
FIT = 0.5  # theta carries a sample to its nodes where its own variance xᵀPx is below this
SHARE = 0.75  # of φ that must be known before anything is expected of a place
LEAST = 0.02  # samples that must be known of a node, or it is new again
FIRST = 0.05  # samples that the first one counts for at least
CHANGED = 0.01  # samples that a node counts for once the plant has changed
BENT = 0.25  # of the second difference of nodes: error between them, at a kink rather more
BELIEVED = 2.0  # visits after which half of that bend is: they have shown what it leaves
SURE = 3.0  # standard deviations by which noise of visits must agree to be more than chance
NEAR = 0.2  # φ from which a sample makes a node known
PRIOR = 10.0  # samples that the mean square of all d counts for in a node's own
SPREAD_MEMORY = 100.0  # samples that a node's mean square remembers
POWER_MEMORY = 10_000.0  # samples that the mean square of all remembers
CLIP = 4.0  # standard deviations beyond which d counts as so many: outliers
HETEROGENEOUS = 1.2  # times the mean square of all: what a node's may be by chance
APART = 64.0  # samples after which noise has forgotten: a longer stay is another visit, visits
# closer together are one
VISIT_MEMORY = 30_000.0  # samples in visits that their mean square remembers
LAG_MEMORY = 3000.0  # samples in visits that the lag is the mean of
FULL_VISIT = 2.0  # looks of a visit that counts full in the pace of forgetting
HASTE_STEP = 0.05  # per visit: a lag is answered within a hundred of them
PROVEN_STEP = 0.1  # the same once drift is proven: only its pace is to be found then
TOLERATED = 0.1  # colour of visits that is let be
ONCE_PROVEN = 0.03  # the same while drift is proven: it goes on until visits speak against it
LONGEST = 2e5  # samples that a place is remembered as long as nothing is seen to drift
PROVEN = 2.0  # logarithm of how many times shorter memory is drift
REVISITS = 0.5  # of the mean time between visits to a node: memory is no shorter
UNVISITED = 4.0  # times the mean square of misfit: error of a node never visited
UNSURE = 4.0  # times the mean square of visits that a place seen once may be wrong by
MOST_COLOUR = 4.0  # of one pair of visits
WHITE = 0.7  # of the noise between looks: noise between samples from which on it does not last
LASTING = 0.4  # what a visit counts for where it does: visits to places side by side share it
IN_ORDER = 0.8  # share of visits that follow the one they followed a round before
MISFIT_RATE = 1.0 / 200.0  # per visit
NEW_RATE = 1.0 / 100.0
EQUAL = 16.0  # looks from which all places count alike
REFIT = 512  # samples after which theta is fitted anew while it drifts
YOUNG, LOOK_EVERY_YOUNG = 16_384, 2  # samples; of those one of so many is held against its place,
LOOK_EVERY = 8  # of later ones one of so many,
LOOK_EVERY_DRIFTING = 4  # and of those while drift is proven; under suspicion all
SEEN_OFTEN = 4.0  # visits from which one is compared with the one before
AGEING = 5e-7  # of the flow per sample: what a valve may wear unnoticed, 18 %/h at 100 Hz
WORN = 0.06  # share of wear that is doubted: three times as much would be needed for an alarm
MOST_HALVINGS = 30  # of d: nothing of it is left
FEW = 1.1  # of d halved by each visit: one stay at a place seen twice comes to T = 21, for any d
LATE, BACK = 2.0**23, 2.0**22  # samples: where the clock is set back, and by how many
MOST = 1e30  # l/min, or its square: more than any flow, and single precision holds it
REST = 1024.0  # samples at one place after which the clock stands: a valve at rest does not wear
AT_REST = 0.05  # steps of the grid within which it is one place


class Remembered(NamedTuple):
    """What one state remembers of K nodes.

    flows : (K,)
        l/min.
    places : (K, FIELDS), visits : (K, FIELDS_OF_VISITS)
        The fields above.
    """

    flows: Floats
    places: Singles
    visits: Codes


@inlined
def look(
    size: Size,
    s: Floats,
    at: Places,
    nodes: Floats,
    own: Remembered,
    box: Floats,
    a: float,
    b: float,
    e: float,
    r: float,
    counters: Counts,
    rule: Rule,
) -> float:
    """Hold a sample against what its place is known for, and remember it; d, NaN where new.

    Parameters
    ----------
    size, s, at
        The row of the state: regressor in ``x``; ``detector`` is written, there LOCAL and COMMON:
        variance of what d has in common with others of this visit, and of others before.
    nodes : (K, n)
        Regressors at the nodes.
    own
        What the state remembers of them, written.
    box : (8,)
        Scratch.
    a, b
        Place in steps of the grid; outside of it, or NaN, nothing is remembered.
    e, r
        Innovation before the update, xᵀPx.
    counters, rule
        Of the state.
    """
    n = len(size)
    g = at.detector
    inside = a >= 0.0 and a <= NODES_A - 1.0 and b >= 0.0 and b <= NODES_B - 1.0
    if not (inside and r < FIT and counters[COUNT] > SETTLED + n):
        return np.nan
    flows, places, visits = own
    tick(s, g, a, b, float(counters[COUNT]))
    if s[g + CLOCK] >= LATE:
        set_back(s, g, places)
    i, j = min(int(a), NODES_A - 2), min(int(b), NODES_B - 2)
    p, q = a - i, b - j
    first = i * NODES_B + j
    nearest = first + (1 if q > 0.5 else 0) + (NODES_B if p > 0.5 else 0)
    stayed = s[g + LOOKED_AT] - s[g + VISIT_BEGAN]
    if nearest != int(s[g + NODE]) or stayed >= APART:
        close_visit(s, at, own, s[g + CLOCK], rule)
        apart = abs(nearest - int(s[g + NODE]))
        row = (apart + 1) // NODES_B * NODES_B
        s[g + SWEPT] = 1.0 if abs(apart - row) <= 1 and row <= NODES_B else 0.0
        away = s[g + CLOCK] - places[nearest, VISITED]
        if nearest != int(s[g + NODE]) and away > APART:
            s[g + AWAY] = away if visits[nearest, VISITS] > 0 else 0.0
        s[g + NODE] = nearest
        s[g + VISIT_BEGAN] = s[g + LOOKED_AT]
        s[g + BEND] = bend(size, s, at, nodes, own, i, nearest - (nearest // NODES_B) * NODES_B)
    now, fading = s[g + CLOCK], s[g + FADING]
    known, sure, c, S, age, flow = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for corner in range(4):
        k = first + (corner & 1) + (corner >> 1) * NODES_B
        f = (q if corner & 1 else 1.0 - q) * (p if corner >> 1 else 1.0 - p)
        expected = 0.0  # by theta, at the node
        for m in range(n):
            expected += nodes[k, m] * s[at.theta + m]
        box[corner] = f
        box[4 + corner] = expected
        if visits[k, VISITS] == 0 and s[g + VISIT_LENGTH] == 0.0:
            places[k, KNOWN] = 0.0  # what theta of then made of it, from another side
        weight = np.float64(places[k, KNOWN])
        if weight > LEAST:
            gone = now - places[k, TOUCHED]
            weight /= 1.0 + fading * gone
            places[k, KNOWN] = weight
            known += f
            if visits[k, VISITS] > 0:
                sure += f
            c += f * (flows[k] - expected)
            S += f * f / weight
            age = max(age, gone)
            flow = max(flow, abs(flows[k]))
        places[k, TOUCHED] = now
    d = np.nan
    s[g + VISIT_LENGTH] += 1.0
    # Carried to a node by theta, a flow is as wrong as its residuals are large.
    variance = s[at.noise + VARIANCE]
    guess = max(FIRST, min(1.0, s[g + FLOOR] / variance)) if variance > 0.0 else 1.0
    if known >= SHARE:
        c /= known
        S /= known * known
        d = e - c
        weight = np.float64(places[nearest, KNOWN])
        spread = (weight * places[nearest, SPREAD] + PRIOR * s[g + POWER]) / (weight + PRIOR)
        wear = AGEING * max(age, s[g + AWAY]) * flow  # all along the visit
        own_part = max(0.0, spread - HETEROGENEOUS * s[g + FLOOR])
        spread = spread * (1.0 + S) + wear * wear
        young = 1.0 + UNSURE / (1.0 + visits[nearest, VISITS])
        of_bend = bent(s, g, visits[nearest, VISITS])
        between = max(young * max(0.0, s[g + VISIT_COMMON]) + of_bend, own_part)
        # A node never visited holds what theta made of it.
        unsure = max(0.0, 1.0 - sure)
        guessed = UNVISITED * unsure * unsure * max(0.0, s[g + MISFIT])
        # Few visits leave open whether the place was ever as it seemed: no stay there decides.
        few = FEW * d / float(1 << min(int(visits[nearest, VISITS]), MOST_HALVINGS))
        s[g + LOCAL] = between + S * s[g + POWER] + guessed + few * few + wear * wear
        whole = s[g + VISIT_WEIGHT] / ((1.0 + s[g + CLOSED]) * LAG_MEMORY)
        chance = SURE * s[g + VISIT_POWER] / np.sqrt(1.0 + s[g + CLOSED])
        s[g + COMMON] = WORN * wear * wear + 2.0 * (
            max(0.0, s[g + LAG] - SURE * s[g + VISIT_POWER] * np.sqrt(whole))
            + max(0.0, s[g + CARRIED] - chance)
        )
        step = d
        if s[g + POWER_WEIGHT] > SETTLED:
            step = min(max(d, -CLIP * np.sqrt(spread)), CLIP * np.sqrt(spread))
        if sure >= SHARE and s[g + SUSPECTED] == 0.0:
            s[g + POWER_WEIGHT] += 1.0 - s[g + POWER_WEIGHT] / POWER_MEMORY
            s[g + POWER] += (step * step / (1.0 + S) - s[g + POWER]) / s[g + POWER_WEIGHT]
        s[g + VISIT_SQUARES] += step * step / (1.0 + S)
        s[g + VISIT_SUM] += step
        again = visits[nearest, VISITS] > 0 and now - places[nearest, VISITED] > APART
        if again and s[g + VISIT_LENGTH] == 1.0 and s[g + SUSPECTED] == 0.0:
            s[g + REVISITED] += 1.0
            s[g + MISFIT] += MISFIT_RATE * (c * e - s[g + MISFIT])
            s[g + MISFIT_POWER] += MISFIT_RATE * (d * d - s[g + MISFIT_POWER])
        gain = step / (1.0 + S)
        for corner in range(4):
            k = first + (corner & 1) + (corner >> 1) * NODES_B
            weight, f = np.float64(places[k, KNOWN]), box[corner]
            # From the far side of a kink a node that is visited learns nothing but drift.
            learns = k == nearest or visits[k, VISITS] == 0 or s[g + HASTE] > PROVEN
            if learns and weight > LEAST and s[g + SUSPECTED] == 0.0:  # nor a change
                flows[k] += gain * f / weight
                weight /= 1.0 - f * f / (weight * (1.0 + S))
                if visits[k, VISITS] == 0 and k != nearest:  # seen from one side alone, so far
                    weight = min(weight, guess)
                places[k, KNOWN] = weight
    if sure >= SHARE:
        s[g + NEW] -= NEW_RATE * s[g + NEW]
    else:
        d = np.nan
        s[g + NEW] += NEW_RATE * (e * s[g + LAST_E] - s[g + NEW])
    s[g + LAST_E] = e
    for corner in range(4):
        k = first + (corner & 1) + (corner >> 1) * NODES_B
        if places[k, KNOWN] <= LEAST and box[corner] > NEAR:
            for m in range(n):
                s[at.g + m] = nodes[k, m]
            if whiten(size, s, at.factor, at.g, at.L) > FIT:
                continue
            flows[k] = box[4 + corner] + e
            places[k, KNOWN] = guess
            places[k, SPREAD] = min(s[g + POWER], MOST)
            visits[k, VISITS] = 0
    return d


@inlined
def tick(s: Floats, g: int, a: float, b: float, count: float) -> None:
    """Let the clock by which places age go on with the samples, but where the valve rests."""
    if abs(a - s[g + REST_A]) + abs(b - s[g + REST_B]) > AT_REST:
        s[g + REST_A] = a
        s[g + REST_B] = b
        s[g + RESTED] = 0.0
    step = min(count - s[g + LOOKED_AT], REST - s[g + RESTED])
    s[g + LOOKED_AT] = count
    s[g + RESTED] += step
    s[g + CLOCK] += step


@inner
def set_back(s: Floats, g: int, places: Singles) -> None:
    """Set the clock back, and with it all that it stamped: every age stays.

    So the stamps of millions of samples are whole numbers that single precision holds; of those
    before, below 0, it tells the age to seven digits.
    """
    s[g + CLOCK] -= BACK
    for k in range(len(places)):
        places[k, TOUCHED] -= BACK
        places[k, VISITED] -= BACK


@inlined
def bend(
    size: Size, s: Floats, at: Places, nodes: Floats, own: Remembered, i: int, j: int
) -> float:
    """How far the residual bends between the nodes of a cell along U: bilinear is wrong by that."""
    largest, before, last = 0.0, 0.0, 0.0
    seen = 0
    for step in range(4):
        column = i - 1 + step
        k = column * NODES_B + j
        if column < 0 or column >= NODES_A or own.places[k, KNOWN] <= LEAST:
            seen = 0
            continue
        c = own.flows[k]
        for m in range(len(size)):
            c -= nodes[k, m] * s[at.theta + m]
        if seen >= 2:
            largest = max(largest, abs(before - 2.0 * last + c))
        before = last
        last = c
        seen += 1
    return BENT * largest


@inlined
def bent(s: Floats, g: int, visits: int) -> float:
    """Variance of what bilinear makes wrong around a node, less with each visit to it."""
    return float(s[g + BEND] * s[g + BEND] * BELIEVED / (BELIEVED + visits))


@inlined
def close_visit(s: Floats, at: Places, own: Remembered, now: float, rule: Rule) -> None:
    """Compare the visit that has ended with the one before to the same node."""
    _, places, visits = own
    g = at.detector
    length = s[g + VISIT_LENGTH]
    k = int(s[g + NODE])
    if length > 0.0 and visits[k, VISITS] > 0 and s[g + SUSPECTED] == 0.0:
        mean = s[g + VISIT_SUM] / length
        power = s[g + VISIT_POWER]
        square = mean * mean
        if s[g + VISIT_WEIGHT] > VISIT_MEMORY / 100.0:
            square = min(square, CLIP * CLIP * power)
        s[g + VISIT_WEIGHT] += length - min(1.0, length / VISIT_MEMORY) * s[g + VISIT_WEIGHT]
        part = length / s[g + VISIT_WEIGHT]
        s[g + VISIT_POWER] += part * (square - power)
        # What the bend does not tell of; where it tells of much, a visit says little about that.
        of_bend = bent(s, g, visits[k, VISITS])
        told = length / (1.0 + length * of_bend / max(s[g + FLOOR], 1e-300)) ** 2
        s[g + COMMON_WEIGHT] += told - min(1.0, length / VISIT_MEMORY) * s[g + COMMON_WEIGHT]
        if told > 0.0:
            beyond = square - s[g + FLOOR] / length - of_bend - s[g + VISIT_COMMON]
            s[g + VISIT_COMMON] += told / s[g + COMMON_WEIGHT] * beyond
        s[g + CLOSED] += 1.0 - part * s[g + CLOSED]
        s[g + CARRIED] += part * (mean * s[g + LAST_MEAN] - s[g + CARRIED])
        s[g + LAST_MEAN] = min(max(mean, -CLIP * np.sqrt(power)), CLIP * np.sqrt(power))
        # Only now: what a visit brings is judged by what was known before it.
        weight = min(places[k, KNOWN], SPREAD_MEMORY)
        share = length / (weight + length)
        square = min(s[g + VISIT_SQUARES] / length, MOST)
        places[k, SPREAD] += share * (square - places[k, SPREAD])
        gap = now - length - places[k, VISITED]
        stayed = s[g + LOOKED_AT] - s[g + VISIT_BEGAN]
        apart = gap > APART or stayed >= APART
        if visits[k, VISITS] > SEEN_OFTEN and apart:
            recent = min(1.0, length / LAG_MEMORY)
            common = max(0.0, s[g + VISIT_COMMON]) + of_bend
            expected = (s[g + FLOOR] / length + common) * (
                s[g + FLOOR] / visits[k, STAYED] + common
            )
            colour = mean * places[k, DEVIATION] / max(np.sqrt(expected), 1e-300)
            colour = min(max(colour, -MOST_COLOUR), MOST_COLOUR)
            s[g + LAG] += recent * (mean * places[k, DEVIATION] - s[g + LAG])
            s[g + GAP] += recent * (max(now - places[k, VISITED], APART) - s[g + GAP])
            tolerated, pace = ONCE_PROVEN, PROVEN_STEP
            if s[g + HASTE] <= PROVEN:
                tolerated, pace = TOLERATED, HASTE_STEP * worth_of_a_visit(s, g)
            haste = s[g + HASTE] + pace * min(1.0, length / FULL_VISIT) * (colour - tolerated)
            if rule.lam == 1.0:
                most = min(rule.most, np.log(LONGEST / (1.0 + REVISITS * s[g + GAP])))
                s[g + HASTE] = max(min(haste, most), 0.0)
        if apart:
            places[k, DEVIATION] = min(max(mean, -MOST), MOST)
            visits[k, STAYED] = min(length, APART)
    if length > 0.0:
        visits[k, VISITS] = min(visits[k, VISITS] + 1, MANY)
        places[k, VISITED] = now
    s[g + VISIT_LENGTH] = 0.0
    s[g + VISIT_SUM] = 0.0
    s[g + VISIT_SQUARES] = 0.0


@inlined
def worth_of_a_visit(s: Floats, g: int) -> float:
    """What a visit counts for where successive ones share slow noise, of correlation ρ.

    ρ² is what products of two visits to a place have in common with those to the place beside it,
    if a round takes all places in the same order. What drift has in common with the visits before
    to the same places is left out of it.
    """
    of_noise = max(0.0, s[g + CARRIED] - max(0.0, s[g + LAG]))
    rho: float = min(of_noise / max(s[g + VISIT_POWER], 1e-300), 1.0)
    worth = 1.0 - IN_ORDER * rho * rho
    return worth * LASTING if noise_lasts(s, g) else worth


@inlined
def noise_lasts(s: Floats, g: int) -> bool:
    """Whether noise lasts from sample to sample: misfit lasts, too, but is not in the step of e."""
    return bool(s[g + SQUARE] - s[g + PRODUCT] < WHITE * s[g + FLOOR])


@maker
def refit(s: Floats, R: Floats, rhs: Floats, own: Remembered, nodes: Floats, now: float) -> None:
    """Theta and P = U·D·Uᵀ by least squares from the flows of all nodes, each as far as known.

    ``R`` and ``rhs`` are scratch and left empty. Where the nodes do not determine theta, all stays.
    """
    flows, places, visits = own
    n = len(rhs)
    at = places_of(n)
    g = at.detector
    gap, ageing = max(s[g + GAP], APART), 0.0  # ageing: of a place's variance, 1/samples²
    if s[g + FLOOR] > 0.0:
        ageing = max(s[g + LAG], 0.0) / (s[g + FLOOR] * gap * gap)
    scale, x = s[at.scale : at.scale + n], np.empty(n)
    for k in range(len(flows)):
        if visits[k, VISITS] > 0:
            aged = ageing * (now - places[k, TOUCHED]) ** 2
            root = np.sqrt(1.0 / (1.0 / min(places[k, KNOWN], EQUAL) + aged))
            for j in range(n):
                x[j] = root * nodes[k, j]
            rotate_in(R, rhs, x, root * flows[k], 1.0, scale, k)
    if independence(R) > INDEPENDENT:
        back_substitute(R, rhs, s[at.theta : at.theta + n])
        settle(s, R)
        for p in range(at.spread, at.variance):
            s[p] = 0.0
    for j in range(n):
        rhs[j] = 0.0
        for k in range(n):
            R[j, k] = 0.0


@inlined
def shake(own: Remembered) -> None:
    """The plant has changed: what is remembered of every place counts next to nothing."""
    for k in range(len(own.flows)):
        own.places[k, KNOWN] = min(own.places[k, KNOWN], CHANGED)
        own.visits[k, VISITS] = 0
