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

import numpy as np

from valvemap.model.kernels.compiled import inlined
from valvemap.model.kernels.place_bend import bend, bent
from valvemap.model.kernels.place_clock import LATE, set_back, tick
from valvemap.model.kernels.place_layout import (
    APART,
    CLIP,
    KNOWN,
    LAG_MEMORY,
    LEAST,
    MOST,
    NODES_A,
    NODES_B,
    PROVEN,
    SPREAD,
    TOUCHED,
    VISITED,
    VISITS,
    Remembered,
)
from valvemap.model.kernels.place_visits import close_visit
from valvemap.model.kernels.row_layout import (
    AWAY,
    BEND,
    CARRIED,
    CLOCK,
    CLOSED,
    COMMON,
    COUNT,
    FADING,
    FLOOR,
    HASTE,
    LAG,
    LAST_E,
    LOCAL,
    LOOKED_AT,
    MISFIT,
    MISFIT_POWER,
    NEW,
    NODE,
    POWER,
    POWER_WEIGHT,
    REVISITED,
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
)
from valvemap.model.kernels.rules import Rule
from valvemap.model.kernels.triangles import whiten
from valvemap.model.samples import Floats

SETTLED = 20  # samples after theta is determined until places are stored
FIT = 0.5  # limit of theta's variance xᵀPx for carrying a sample to its nodes
SHARE = 0.75  # share of φ that must be known for an expectation
FIRST = 0.05  # minimum weight of a node's first sample, samples
CHANGED = 0.01  # samples of a node after a change of the plant
SURE = 3.0  # standard deviations that make correlated noise of visits significant
NEAR = 0.2  # φ from which a sample initializes a node
PRIOR = 10.0  # samples' weight of the overall mean square of d in a node's own
POWER_MEMORY = 10_000.0  # samples; memory of the overall mean square
HETEROGENEOUS = 1.2  # times the overall mean square: limit of a node's by chance
UNVISITED = 4.0  # times the mean square of misfit: squared error of a node never visited
UNSURE = 4.0  # times the mean square of visits: squared error of a place seen once
MISFIT_RATE = 1.0 / 200.0  # per visit
NEW_RATE = 1.0 / 100.0
REFIT = 512  # samples between refits of theta during drift
YOUNG, LOOK_EVERY_YOUNG = 16_384, 2  # samples; stride of looks at them,
LOOK_EVERY = 8  # stride of later looks,
LOOK_EVERY_DRIFTING = 4  # and stride while drift is proven; 1 under suspicion
AGEING = 5e-7  # of the flow per sample: tolerated wear, 18 %/h at 100 Hz
WORN = 0.06  # share of wear taken as uncertain: an alarm needs three times as much
MOST_HALVINGS = 30  # of d: nothing remains
FEW = 1.1  # of d halved at each visit: a stay at a place seen twice gives T = 21 for any d


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
def shake(own: Remembered) -> None:
    """Reduce the information of all places to nearly 0 after a change of the plant."""
    for k in range(len(own.flows)):
        own.places[k, KNOWN] = min(own.places[k, KNOWN], CHANGED)
        own.visits[k, VISITS] = 0
