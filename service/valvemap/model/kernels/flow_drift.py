"""What moves while the map stays: gain and edge, as competing models of a process in time.

    Q = (1 + a(t))·g(U - e(t)·W(U), s),   W(U) = 1 - |U|/U_end: an edge shifts, full opening stays

    STILL            a, e are what they are
    MOVING           their rates are processes of standard deviation RATE, time constant PERSISTENCE
    OTHER_GAIN       a has changed by anything, not long ago
    OTHER_EDGE       e has

Beside them, with a probability of its own against all of them:

    WANDERING        a, e go wherever something without a name takes them, within seconds

An interacting multiple model filter (Blom & Bar-Shalom 1988) over stays: successive samples in one
cell count as one observation, whose variance holds that of the map there. Each side of U = 0 has
filters of its own. States are a, e, da/dt, de/dt (1, %, 1/s, %/s).
"""

import math
from typing import NamedTuple

from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.samples import Floats

STILL, MOVING, OTHER_GAIN, OTHER_EDGE, NAMED = 0, 1, 2, 3, 4
WANDERING, MODELS = NAMED, NAMED + 1
LEVELS, RATES, STATES = 2, 4, 9  # states from LEVELS on are rates; from RATES on, effects of T

# Places of a state.
GAIN, EDGE, RATE_GAIN, RATE_EDGE = 0, 1, 2, 3


class Drift(NamedTuple):
    """Filters of one side.

    Attributes
    ----------
    x : (MODELS, STATES)
    P : (MODELS, STATES, STATES)
    chance : (MODELS,)
        Probabilities of the named models, which sum to 1; that of WANDERING.
    now : (1 + STATES, STATES)
        Mean over the models, then the covariance.
    room : (2, MODELS, STATES + 1, STATES)
    """

    x: Floats
    P: Floats
    chance: Floats
    now: Floats
    room: Floats


@inner
def forget(x: Floats, P: Floats, chance: Floats, now: Floats) -> None:
    """Begin: gain and edge are 0, and may be about to drift."""
    x[:], P[:], chance[:], now[:] = 0.0, 0.0, 0.0, 0.0
    P[MOVING, 2, 2], P[MOVING, 3, 3] = (rules.RATE_GAIN / 3600) ** 2, (rules.RATE_EDGE / 3600) ** 2
    chance[MOVING] = rules.PERSISTENCE / (rules.PERSISTENCE + rules.BETWEEN_DRIFTS)
    chance[STILL] = 1.0 - chance[MOVING]
    for m in range(MODELS):
        for k in range(RATES, STATES):
            P[m, k, k] = rules.WARMTH**2
    for k in range(RATES, STATES):
        now[1 + k, k] = rules.WARMTH**2


@kernel
def begin(x: Floats, P: Floats, chance: Floats, now: Floats) -> None:
    """`forget` both sides."""
    for side in range(2):
        forget(x[side], P[side], chance[side], now[side])


@inner
def step(
    drift: Drift, dt: float, jumps: float, nameless: float, warmed: float, residual: float,
    by: Floats, variance: float,
) -> float:  # fmt: skip
    """Advance by ``dt`` s, in which ``jumps`` are expected, then learn from a stay.

    ``nameless`` of what has no name are expected to begin.

    ``warmed`` K since the last stay add variance to the effects of T: the law is not exact.

    Give the square of the stay in variances, a mean over the models as they were before it.
    ``residual`` is measured against `now`; ``by`` (STATES,) are its derivatives by the states.
    """
    known = residual
    for k in range(STATES):
        known += by[k] * drift.now[0, k]
    if dt > 0.0:
        _mix(drift, dt, jumps, nameless)
        _advance(drift, dt)
    if warmed > 0.0:
        for m in range(MODELS):
            for k in range(RATES, STATES):
                drift.P[m, k, k] += (rules.OTHER_LAW * drift.x[m, k]) ** 2 * warmed
    total = surprise = 0.0
    largest = -math.inf
    for m in range(MODELS):
        x, P, said = drift.x[m], drift.P[m], drift.room[0, m]
        off, S = known, variance
        for k in range(STATES):
            off -= by[k] * x[k]
            said[0, k] = 0.0
            for j in range(STATES):
                said[0, k] += P[k, j] * by[j]
        for k in range(STATES):
            S += by[k] * said[0, k]
        square = off * off / S
        doubted = S + (off / rules.MOST_STAY) ** 2  # the map is a straight line nearby only
        for k in range(STATES):
            x[k] += said[0, k] * off / doubted
            for j in range(STATES):
                P[k, j] -= said[0, k] * said[0, j] / doubted
        if m < NAMED:
            surprise += drift.chance[m] * min(square, rules.MOST_STAY**2)
        log = -0.5 * (math.log(S) + min(square, rules.MOST_STAY**2))
        drift.room[1, m, 0, 0] = log
        largest = max(largest, log)
    for m in range(NAMED):
        drift.chance[m] *= math.exp(drift.room[1, m, 0, 0] - largest)
        total += drift.chance[m]
    for m in range(NAMED):
        drift.chance[m] /= total
    wanders = drift.chance[WANDERING] * math.exp(drift.room[1, WANDERING, 0, 0] - largest)
    drift.chance[WANDERING] = wanders / (wanders + (1.0 - drift.chance[WANDERING]) * total)
    _combine(drift)
    return surprise


@inner
def _transition(m: int, k: int, dt: float, jump: float) -> float:
    """Probability of going from model m to model k within ``dt``."""
    over = min(dt / rules.AFTER_JUMP, 0.5)
    if k >= OTHER_GAIN:
        if m >= OTHER_GAIN:
            return 1.0 - over if m == k else 0.0
        return 0.5 * jump
    if m >= OTHER_GAIN:
        return 0.9 * over if k == STILL else 0.1 * over
    change = min(dt / (rules.BETWEEN_DRIFTS if m == STILL else rules.PERSISTENCE), 0.1)
    return (change if m != k else 1.0 - change) * (1.0 - jump)


@inner
def _mix(drift: Drift, dt: float, jumps: float, nameless: float) -> None:
    """Give each model what the others know, as far as they may turn into it."""
    _let_wander(drift, dt, nameless)
    x, P, chance, room = drift.x, drift.P, drift.chance, drift.room
    for k in range(NAMED):
        room[0, k] = 0.0
        total = 0.0
        for m in range(NAMED):
            part = _transition(m, k, dt, jumps) * chance[m]
            room[1, m, 0, k] = part
            total += part
            for i in range(STATES):
                room[0, k, 0, i] += part * x[m, i]
        room[1, k, 1, 0] = total
        total = max(total, 1e-300)
        for i in range(STATES):
            room[0, k, 0, i] /= total
        for m in range(NAMED):
            part = room[1, m, 0, k] / total
            for i in range(STATES):
                for j in range(STATES):
                    off = (x[m, i] - room[0, k, 0, i]) * (x[m, j] - room[0, k, 0, j])
                    room[0, k, 1 + i, j] += part * (P[m, i, j] + off)
            if k == OTHER_GAIN and m < OTHER_GAIN:
                room[0, k, 1, 0] += part * rules.JUMP_GAIN**2
            if k == OTHER_EDGE and m < OTHER_GAIN:
                room[0, k, 2, 1] += part * rules.JUMP_EDGE**2
    for k in range(NAMED):
        chance[k] = room[1, k, 1, 0]
        for i in range(STATES):
            x[k, i] = room[0, k, 0, i]
            for j in range(STATES):
                P[k, i, j] = room[0, k, 1 + i, j]


@inner
def _let_wander(drift: Drift, dt: float, nameless: float) -> None:
    """Something without a name begins, where all is still."""
    x, P, chance = drift.x, drift.P, drift.chance
    stays = chance[WANDERING] * (1.0 - min(dt / rules.PERSISTENCE, 0.1))
    begins = (1.0 - chance[WANDERING]) * nameless
    chance[WANDERING] = stays + begins
    share = begins / max(stays + begins, 1e-300)
    for i in range(STATES):
        for j in range(STATES):
            off = (x[STILL, i] - x[WANDERING, i]) * (x[STILL, j] - x[WANDERING, j])
            P[WANDERING, i, j] += share * (P[STILL, i, j] - P[WANDERING, i, j])
            P[WANDERING, i, j] += share * (1.0 - share) * off
    for i in range(STATES):
        x[WANDERING, i] += share * (x[STILL, i] - x[WANDERING, i])


@inner
def _advance(drift: Drift, dt: float) -> None:
    """Prediction of each model."""
    for m in range(MODELS):
        x, P = drift.x[m], drift.P[m]
        if m != MOVING:
            for k in range(LEVELS, RATES):
                x[k] = 0.0
                for j in range(STATES):
                    P[k, j] = P[j, k] = 0.0
        if m == WANDERING:
            lost = 1.0 - math.exp(-2.0 * dt / rules.WANDERS_WITHIN)
            P[0, 0] += lost * rules.NAMELESS_GAIN**2
            P[1, 1] += lost * rules.JUMP_EDGE**2
        if m == MOVING:
            keep = math.exp(-dt / rules.PERSISTENCE)
            for k in range(2):
                x[k] += dt * x[k + 2]
                for j in range(STATES):
                    P[k, j] += dt * P[k + 2, j]
                for j in range(STATES):
                    P[j, k] += dt * P[j, k + 2]
            for k in range(LEVELS, RATES):
                x[k] *= keep
                for j in range(STATES):
                    P[k, j] *= keep
                    P[j, k] *= keep
            P[0, 0] += dt * rules.WANDER_GAIN**2 / 3600.0
            P[1, 1] += dt * rules.WANDER_EDGE**2 / 3600.0
            P[2, 2] += (1.0 - keep * keep) * (rules.RATE_GAIN / 3600.0) ** 2
            P[3, 3] += (1.0 - keep * keep) * (rules.RATE_EDGE / 3600.0) ** 2


@inner
def _combine(drift: Drift) -> None:
    """Mean and covariance over the named models.

    What has no name may be neither gain nor edge: while something wanders, they have a doubt as
    large as a sudden change besides.
    """
    x, P, chance, now = drift.x, drift.P, drift.chance, drift.now
    now[:] = 0.0
    for m in range(NAMED):
        for k in range(STATES):
            now[0, k] += chance[m] * x[m, k]
    for m in range(NAMED):
        for k in range(STATES):
            for j in range(STATES):
                off = (x[m, k] - now[0, k]) * (x[m, j] - now[0, j])
                now[1 + k, j] += chance[m] * (P[m, k, j] + off)
    now[1 + GAIN, GAIN] += chance[WANDERING] * rules.NAMELESS_GAIN**2
    now[1 + EDGE, EDGE] += chance[WANDERING] * rules.JUMP_EDGE**2
