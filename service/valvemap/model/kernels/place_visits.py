"""A completed visit to a node, compared with the previous one: drift, lasting noise, misfit."""

import numpy as np

from valvemap.model.kernels.compiled import inlined
from valvemap.model.kernels.place_bend import bent
from valvemap.model.kernels.place_layout import (
    APART,
    CLIP,
    DEVIATION,
    KNOWN,
    LAG_MEMORY,
    MANY,
    MOST,
    PROVEN,
    SPREAD,
    STAYED,
    VISITED,
    VISITS,
    Remembered,
)
from valvemap.model.kernels.row_layout import (
    CARRIED,
    CLOSED,
    COMMON_WEIGHT,
    FLOOR,
    GAP,
    HASTE,
    LAG,
    LAST_MEAN,
    LOOKED_AT,
    NODE,
    PRODUCT,
    SQUARE,
    SUSPECTED,
    VISIT_BEGAN,
    VISIT_COMMON,
    VISIT_LENGTH,
    VISIT_POWER,
    VISIT_SQUARES,
    VISIT_SUM,
    VISIT_WEIGHT,
    Places,
)
from valvemap.model.kernels.rules import Rule
from valvemap.model.samples import Floats

SPREAD_MEMORY = 100.0  # samples; memory of a node's mean square
VISIT_MEMORY = 30_000.0  # samples in visits; memory of their mean square
FULL_VISIT = 2.0  # looks of a visit with full weight in the pace of forgetting
HASTE_STEP = 0.05  # per visit: reacts to a lag within a hundred visits
PROVEN_STEP = 0.1  # the same once drift is proven and only its pace is unknown
TOLERATED = 0.1  # correlation of visits that is tolerated
ONCE_PROVEN = 0.03  # the same while drift is proven, until visits contradict it
LONGEST = 2e5  # samples; memory of a place without drift
REVISITS = 0.5  # lower limit of the memory, in mean times between visits to a node
MOST_COLOUR = 4.0  # limit of the correlation of one pair of visits
WHITE = 0.7  # of the noise between looks: ratio of sample noise from which it is not lasting
LASTING = 0.4  # weight of a visit in lasting noise, which neighbouring visits share
IN_ORDER = 0.8  # share of visits whose predecessor is the same as in the previous round
SEEN_OFTEN = 4.0  # visits from which one is compared with the previous


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
