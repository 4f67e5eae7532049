"""Memory of places: measured flows on a grid over (U, √dp), independent of the structure.

Node k of the grid stores the measured flow v. Only the slopes of the structure are used, to carry
a sample to the surrounding nodes. The residual expected from earlier visits is
c = Σ φₖ·(vₖ - Xₖᵀtheta), φ bilinear. Thus

- e = c + d: the innovation e consists of the expected part c and the new part d;
- c is structural misfit: it repeats while the plant does not change;
- d is noise while the plant does not change, for any structure.

A node's flow is a running mean with the gain of a Kalman filter with diagonal covariance. Its
information fades with time. The steps of the mean may be below the resolution of single precision,
so flows are in double precision; all other fields of a node are in single precision.

Drift is separated from noise and misfit by visits: the mean of d over a visit to a node, times that
of the previous visit. The noise of separate visits is independent, even if it is coloured, and d
contains no misfit; so the average of the products is the squared lag of the memory. If it exceeds
TOLERATED, the information of the nodes and of theta fades faster, but not faster than places are
revisited. Theta is then refitted to the flows of all nodes: each place contributes its newest flow,
and no place is lost.
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

# Fields of a node in `places`: effective samples of its flow; clock time of the last touch; mean
# square of d around it; mean of d over the last visit; end of that visit.
KNOWN, TOUCHED, SPREAD, DEVIATION, VISITED = range(5)
FIELDS = 5
# In `visits`: number since the plant changed, up to MANY; looks of the last visit.
VISITS, STAYED = range(2)
FIELDS_OF_VISITS = 2
MANY = 255

NODES_A, NODES_B = 17, 12  # of the grid, along U and √dp
TOP_DP = 225.0  # bar: the last node

SETTLED = 20  # samples after theta is determined until places are stored
FIT = 0.5  # limit of theta's variance xᵀPx for carrying a sample to its nodes
SHARE = 0.75  # share of φ that must be known for an expectation
LEAST = 0.02  # samples of a node below which it counts as new
FIRST = 0.05  # minimum weight of a node's first sample, samples
CHANGED = 0.01  # samples of a node after a change of the plant
BENT = 0.25  # of the nodes' second difference: interpolation error, rather more at a kink
BELIEVED = 2.0  # visits after which half of that error remains in the variance
SURE = 3.0  # standard deviations that make correlated noise of visits significant
NEAR = 0.2  # φ from which a sample initializes a node
PRIOR = 10.0  # samples' weight of the overall mean square of d in a node's own
SPREAD_MEMORY = 100.0  # samples; memory of a node's mean square
POWER_MEMORY = 10_000.0  # samples; memory of the overall mean square
CLIP = 4.0  # standard deviations at which d is clipped: outliers
HETEROGENEOUS = 1.2  # times the overall mean square: limit of a node's by chance
APART = 64.0  # samples; noise is uncorrelated beyond: a longer stay counts as another visit,
# and visits closer together as one
VISIT_MEMORY = 30_000.0  # samples in visits; memory of their mean square
LAG_MEMORY = 3000.0  # samples in visits; memory of the lag
FULL_VISIT = 2.0  # looks of a visit with full weight in the pace of forgetting
HASTE_STEP = 0.05  # per visit: reacts to a lag within a hundred visits
PROVEN_STEP = 0.1  # the same once drift is proven and only its pace is unknown
TOLERATED = 0.1  # correlation of visits that is tolerated
ONCE_PROVEN = 0.03  # the same while drift is proven, until visits contradict it
LONGEST = 2e5  # samples; memory of a place without drift
PROVEN = 2.0  # logarithm of the speed-up of forgetting from which drift is proven
REVISITS = 0.5  # lower limit of the memory, in mean times between visits to a node
UNVISITED = 4.0  # times the mean square of misfit: squared error of a node never visited
UNSURE = 4.0  # times the mean square of visits: squared error of a place seen once
MOST_COLOUR = 4.0  # limit of the correlation of one pair of visits
WHITE = 0.7  # of the noise between looks: ratio of sample noise from which it is not lasting
LASTING = 0.4  # weight of a visit in lasting noise, which neighbouring visits share
IN_ORDER = 0.8  # share of visits whose predecessor is the same as in the previous round
MISFIT_RATE = 1.0 / 200.0  # per visit
NEW_RATE = 1.0 / 100.0
EQUAL = 16.0  # looks from which all places have equal weight
REFIT = 512  # samples between refits of theta during drift
YOUNG, LOOK_EVERY_YOUNG = 16_384, 2  # samples; stride of looks at them,
LOOK_EVERY = 8  # stride of later looks,
LOOK_EVERY_DRIFTING = 4  # and stride while drift is proven; 1 under suspicion
SEEN_OFTEN = 4.0  # visits from which one is compared with the previous
AGEING = 5e-7  # of the flow per sample: tolerated wear, 18 %/h at 100 Hz
WORN = 0.06  # share of wear taken as uncertain: an alarm needs three times as much
MOST_HALVINGS = 30  # of d: nothing remains
FEW = 1.1  # of d halved at each visit: a stay at a place seen twice gives T = 21 for any d
LATE, BACK = 2.0**23, 2.0**22  # samples: clock value at which it is set back, and the amount
MOST = 1e30  # l/min, or its square: larger than any flow, within single precision
REST = 1024.0  # samples at one place after which the clock stops: a valve at rest does not wear
AT_REST = 0.05  # steps of the grid that count as one place


class Remembered(NamedTuple):
    """Memory of K nodes of one state.

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
    """Update the memory with a sample; return d, NaN at a new place.

    Parameters
    ----------
    size, s, at
        The row of the state: regressor in ``x``; ``detector`` is written, including LOCAL and
        COMMON: variance that d shares with others of this visit, and of earlier visits.
    nodes : (K, n)
        Regressors at the nodes.
    own
        The state's memory, written.
    box : (8,)
        Scratch.
    a, b
        Place in steps of the grid; outside of it, or NaN, nothing is stored.
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
        expected = 0.0  # predicted by theta at the node
        for m in range(n):
            expected += nodes[k, m] * s[at.theta + m]
        box[corner] = f
        box[4 + corner] = expected
        if visits[k, VISITS] == 0 and s[g + VISIT_LENGTH] == 0.0:
            places[k, KNOWN] = 0.0  # predicted by an earlier theta, from another side
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
    # Theta carries a flow to a node with an error of the size of the residuals.
    variance = s[at.noise + VARIANCE]
    guess = max(FIRST, min(1.0, s[g + FLOOR] / variance)) if variance > 0.0 else 1.0
    if known >= SHARE:
        c /= known
        S /= known * known
        d = e - c
        weight = np.float64(places[nearest, KNOWN])
        spread = (weight * places[nearest, SPREAD] + PRIOR * s[g + POWER]) / (weight + PRIOR)
        wear = AGEING * max(age, s[g + AWAY]) * flow  # constant during the visit
        own_part = max(0.0, spread - HETEROGENEOUS * s[g + FLOOR])
        spread = spread * (1.0 + S) + wear * wear
        young = 1.0 + UNSURE / (1.0 + visits[nearest, VISITS])
        of_bend = bent(s, g, visits[nearest, VISITS])
        between = max(young * max(0.0, s[g + VISIT_COMMON]) + of_bend, own_part)
        # The flow of a node never visited is theta's prediction.
        unsure = max(0.0, 1.0 - sure)
        guessed = UNVISITED * unsure * unsure * max(0.0, s[g + MISFIT])
        # After few visits a place's flow is uncertain: a single stay there must not cause an alarm.
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
            # Across a kink, samples do not update a visited node, except during drift.
            learns = k == nearest or visits[k, VISITS] == 0 or s[g + HASTE] > PROVEN
            if learns and weight > LEAST and s[g + SUSPECTED] == 0.0:  # nor during a change
                flows[k] += gain * f / weight
                weight /= 1.0 - f * f / (weight * (1.0 + S))
                if visits[k, VISITS] == 0 and k != nearest:  # known from one side only
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
    """Advance the clock by which places age, unless the valve rests."""
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
    """Set the clock and all its timestamps back; ages stay the same.

    Timestamps of millions of samples thus stay integers within single precision. Earlier ones,
    below 0, keep their age to seven digits.
    """
    s[g + CLOCK] -= BACK
    for k in range(len(places)):
        places[k, TOUCHED] -= BACK
        places[k, VISITED] -= BACK


@inlined
def bend(
    size: Size, s: Floats, at: Places, nodes: Floats, own: Remembered, i: int, j: int
) -> float:
    """Curvature of the residual along U around a cell, an estimate of the interpolation error."""
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
    """Variance of the interpolation error around a node; decreases with each visit."""
    return float(s[g + BEND] * s[g + BEND] * BELIEVED / (BELIEVED + visits))


@inlined
def close_visit(s: Floats, at: Places, own: Remembered, now: float, rule: Rule) -> None:
    """Compare the completed visit with the previous one to the same node."""
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
        # Part not explained by the bend; where the bend explains much, a visit has little weight.
        of_bend = bent(s, g, visits[k, VISITS])
        told = length / (1.0 + length * of_bend / max(s[g + FLOOR], 1e-300)) ** 2
        s[g + COMMON_WEIGHT] += told - min(1.0, length / VISIT_MEMORY) * s[g + COMMON_WEIGHT]
        if told > 0.0:
            beyond = square - s[g + FLOOR] / length - of_bend - s[g + VISIT_COMMON]
            s[g + VISIT_COMMON] += told / s[g + COMMON_WEIGHT] * beyond
        s[g + CLOSED] += 1.0 - part * s[g + CLOSED]
        s[g + CARRIED] += part * (mean * s[g + LAST_MEAN] - s[g + CARRIED])
        s[g + LAST_MEAN] = min(max(mean, -CLIP * np.sqrt(power)), CLIP * np.sqrt(power))
        # Updated last: a visit is compared with what was known before it.
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
    """Weight of a visit if successive visits share slow noise with correlation ρ.

    ρ² is the common part of the products of two visits to a place and those to its neighbour, if
    each round visits the places in the same order. The part that drift shares with earlier visits
    to the same places is excluded.
    """
    of_noise = max(0.0, s[g + CARRIED] - max(0.0, s[g + LAG]))
    rho: float = min(of_noise / max(s[g + VISIT_POWER], 1e-300), 1.0)
    worth = 1.0 - IN_ORDER * rho * rho
    return worth * LASTING if noise_lasts(s, g) else worth


@inlined
def noise_lasts(s: Floats, g: int) -> bool:
    """Whether noise lasts between samples. Misfit lasts, too, but not in the steps of e."""
    return bool(s[g + SQUARE] - s[g + PRODUCT] < WHITE * s[g + FLOOR])


@maker
def refit(s: Floats, R: Floats, rhs: Floats, own: Remembered, nodes: Floats, now: float) -> None:
    """Fit theta and P = U·D·Uᵀ by least squares to the flows of all nodes, weighted by information.

    ``R`` and ``rhs`` are scratch and left empty. If the nodes do not determine theta, it is kept.
    """
    flows, places, visits = own
    n = len(rhs)
    at = places_of(n)
    g = at.detector
    gap, ageing = max(s[g + GAP], APART), 0.0  # ageing of a place's variance, 1/samples²
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
    """Reduce the information of all places to nearly 0 after a change of the plant."""
    for k in range(len(own.flows)):
        own.places[k, KNOWN] = min(own.places[k, KNOWN], CHANGED)
        own.visits[k, VISITS] = 0
