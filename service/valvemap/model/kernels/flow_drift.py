"""What moves while the map stays: levels, as competing models of a process in time.

    Q = (1 + a(t))·g(U - e(t)·W(U), s(Δp - d(t))) + o(t),   W(U) = 1 - |U|/U_end

An edge shifts by e, full opening stays. Gain a and edge e are the valve's; o and d
are the sensors': offsets of the flow and of Δp. `rules.LEVELS` has a row for each level.
Rates of a and e grow from none: where a part of an edge wears, not all of it drifts.

    STILL            levels are what they are
    MOVING           rates of a and e are processes, time constant PERSISTENCE; both walk besides
    SENSING          those of o and d as well
    OTHER_GAIN       a has changed by anything, not long ago
    OTHER_EDGE       e has
    OTHER_ZERO       o has
    OTHER_PRESSURE   d has

Beside them, with a probability of its own against all of them:

    WANDERING        a, e go wherever something without a name takes them, within seconds

An interacting multiple model filter (Blom & Bar-Shalom 1988) over stays: successive samples in one
cell count as one observation, whose variance holds that of the map there. Each side of U = 0 has
filters of its own. States are a, e, o, d (1, %, of the flow, of Δp), effects of T, rates.
"""

import math
from typing import NamedTuple

from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner, kernel
from valvemap.model.samples import Floats

STILL, MOVING, SENSING, OTHER_GAIN, OTHER_EDGE, OTHER_ZERO, OTHER_PRESSURE, NAMED = range(8)
WANDERING, MODELS = NAMED, NAMED + 1
OF_VALVE = 2  # levels before it are the valve's, others the sensors'
LEVELS, RATES, STATES = 4, 9, 13  # states from LEVELS on are effects of T, from RATES on rates
SIZES = RATES, RATES + OF_VALVE, STATES, *(RATES,) * (MODELS - OTHER_GAIN)  # of each model
SHOWN = RATES + OF_VALVE  # states of which the mean over the models is kept
_NUMBERS = [n * (n + 1) // 2 for n in SIZES]  # of a covariance, see `pack`
PLACES = tuple(sum(_NUMBERS[:m]) for m in range(MODELS))  # where each begins
PACKED = sum(_NUMBERS)

# Places of a state.
GAIN, EDGE, ZERO, PRESSURE = 0, 1, 2, 3


class Drift(NamedTuple):
    """Filters of one side.

    Attributes
    ----------
    x : (MODELS, STATES)
    P : (PACKED,)
        Covariances, see `pack` and `PLACES`.
    chance : (MODELS,)
        Probabilities of the named models, which sum to 1; that of WANDERING.
    now : (1 + SHOWN, SHOWN)
        Mean over the models, then the covariance.
    room : (2, MODELS, STATES + 1, STATES)
    """

    x: Floats
    P: Floats
    chance: Floats
    now: Floats
    room: Floats


@inner
def pack(i: int, j: int) -> int:
    """Place of an element of a symmetric matrix: rows of its lower triangle."""
    return i * (i + 1) // 2 + j if i >= j else j * (j + 1) // 2 + i


@inner
def jumped(chance: Floats) -> float:
    """Probability that a level has changed suddenly."""
    total = 0.0
    for m in range(OTHER_GAIN, NAMED):
        total += chance[m]
    return total


@inner
def drifting(chance: Floats) -> float:
    """Probability that a level drifts."""
    return float(chance[MOVING] + chance[SENSING])


@inner
def forget(x: Floats, P: Floats, chance: Floats, now: Floats) -> None:
    """Begin: levels are 0, and may be about to drift."""
    x[:], P[:], chance[:], now[:] = 0.0, 0.0, 0.0, 0.0
    for m in range(MOVING, SENSING + 1):
        for k in range(SIZES[m] - RATES):
            P[PLACES[m] + pack(RATES + k, RATES + k)] = (rules.LEVELS[k][0] / 3600.0) ** 2
        chance[m] = rules.PERSISTENCE / (2.0 * rules.PERSISTENCE + rules.BETWEEN_DRIFTS)
    chance[STILL] = 1.0 - chance[MOVING] - chance[SENSING]
    for m in range(MODELS):
        for k in range(LEVELS, RATES):
            P[PLACES[m] + pack(k, k)] = rules.WARMTH**2
    for k in range(LEVELS, RATES):
        now[1 + k, k] = rules.WARMTH**2


@kernel
def begin(x: Floats, P: Floats, chance: Floats, now: Floats) -> None:
    """`forget` all sides."""
    for side in range(len(x)):
        forget(x[side], P[side], chance[side], now[side])


@inner
def step(
    drift: Drift, dt: float, jumps: float, over: float, nameless: float, residual: float,
    by: Floats, variance: float,
) -> float:  # fmt: skip
    """Advance by ``dt`` s, in which ``jumps`` are expected, then learn from a stay.

    ``over`` is the probability that a jump of before is a hypothesis of its own no longer.
    ``nameless`` of what has no name are expected to begin.

    Give the square of the stay in variances, a mean over the models as they were before it.
    ``residual`` is measured against `now`; ``by`` (STATES,) are its derivatives by the states.
    """
    known = _as_at_first(drift, residual, by)
    if dt > 0.0:
        _mix(drift, dt, jumps, over, nameless)
        _advance(drift, dt)
    total = surprise = 0.0
    largest = -math.inf
    for m in range(MODELS):
        off, S = _weigh(drift, m, known, by, variance)
        square = off * off / S
        _correct(drift, m, off, S, False)  # noqa: FBT003 - numba knows no keyword
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
def learn_of_T(drift: Drift, residual: float, by: Floats, variance: float) -> None:
    """Learn effects of T alone, by a stay of a map that is too young to tell what moves.

    The variance of levels makes it tell less (Schmidt 1966).
    """
    known = _as_at_first(drift, residual, by)
    for m in range(MODELS):
        off, S = _weigh(drift, m, known, by, variance)
        _correct(drift, m, off, S, True)  # noqa: FBT003 - numba knows no keyword
    _combine(drift)


@inner
def expect(drift: Drift, kind: int, size: float, variance: float) -> None:
    """Take a sudden change of a sensor for as likely as none: the other side of U = 0 shows it."""
    x, still, other = drift.x, drift.P[PLACES[STILL] :], drift.P[PLACES[kind] :]
    for i in range(RATES):
        x[kind, i] = x[STILL, i]
        for j in range(i + 1):
            other[pack(i, j)] = still[pack(i, j)]
    level = kind - OTHER_GAIN
    x[kind, level] += size
    other[pack(level, level)] += variance
    for m in range(NAMED):
        drift.chance[m] *= 0.5
    drift.chance[kind] += 0.5


@inner
def _as_at_first(drift: Drift, residual: float, by: Floats) -> float:
    """What a stay differs by from the map as it was at first."""
    for k in range(RATES):
        residual += by[k] * drift.now[0, k]
    return residual


@inner
def _weigh(
    drift: Drift, m: int, known: float, by: Floats, variance: float
) -> tuple[float, float]:  # fmt: skip
    """By how much a stay is off for model ``m``, and the variance of that."""
    x, P, said = drift.x[m], drift.P[PLACES[m] :], drift.room[0, m]
    off, S = known, variance
    for k in range(RATES):
        off -= by[k] * x[k]
    for k in range(SIZES[m]):
        said[0, k] = 0.0
        for j in range(RATES):
            said[0, k] += P[pack(k, j)] * by[j]
    for k in range(RATES):
        S += by[k] * said[0, k]
    return off, S


@inner
def _correct(drift: Drift, m: int, off: float, S: float, of_T_alone: bool) -> None:  # noqa: FBT001
    """Let model ``m`` follow what `_weigh` found."""
    x, P, said = drift.x[m], drift.P[PLACES[m] :], drift.room[0, m]
    doubted = max(S, (off / rules.MOST_STAY) ** 2)  # the map is a straight line nearby only
    for k in range(SIZES[m]):
        learns = not of_T_alone or LEVELS <= k < RATES
        if learns:
            x[k] += said[0, k] * off / doubted
        for j in range(k + 1):
            if learns or LEVELS <= j < RATES:
                P[pack(k, j)] -= said[0, k] * said[0, j] / doubted


@inner
def _transition(m: int, k: int, dt: float, jump: float, over: float) -> float:
    """Probability of going from model m to model k within ``dt``."""
    if k >= OTHER_GAIN:
        if m >= OTHER_GAIN:
            return 1.0 - over if m == k else 0.0
        return (0.5 if k <= OTHER_EDGE else rules.SENSORS_JUMP) * jump
    if m >= OTHER_GAIN:
        drifts = 0.1 if over == 1.0 else 0.0  # a jump in doubt is no drift
        return (1.0 - drifts if k == STILL else drifts if k == MOVING else 0.0) * over
    begins, ends = min(dt / rules.BETWEEN_DRIFTS, 0.1), min(dt / rules.PERSISTENCE, 0.1)
    if m == k:
        return (1.0 - (2.0 * begins if m == STILL else begins + ends)) * (1.0 - jump)
    return (begins if m == STILL or k == SENSING else ends) * (1.0 - jump)


@inner
def _mix(drift: Drift, dt: float, jumps: float, over: float, nameless: float) -> None:
    """Give each model what the others know, as far as they may turn into it."""
    _let_wander(drift, dt, nameless)
    x, chance, room = drift.x, drift.chance, drift.room
    for k in range(NAMED):
        room[0, k] = 0.0
        total = 0.0
        for m in range(NAMED):
            part = _transition(m, k, dt, jumps, over) * chance[m]
            room[1, m, 0, k] = part
            total += part
            for i in range(SIZES[k]):
                room[0, k, 0, i] += part * x[m, i]
        room[1, k, 1, 0] = total
        total = max(total, 1e-300)
        for i in range(SIZES[k]):
            room[0, k, 0, i] /= total
        for m in range(NAMED):
            part, P = room[1, m, 0, k] / total, drift.P[PLACES[m] :]
            if part == 0.0:
                continue
            for i in range(SIZES[k]):
                for j in range(i + 1):
                    off = (x[m, i] - room[0, k, 0, i]) * (x[m, j] - room[0, k, 0, j])
                    off += P[pack(i, j)] if i < SIZES[m] else 0.0
                    room[0, k, 1 + i, j] += part * off
            for i in range(max(SIZES[m], SIZES[MOVING]), SIZES[k]):  # an offset begins to drift
                room[0, k, 1 + i, i] += part * (rules.LEVELS[i - RATES][0] / 3600.0) ** 2
            if m < OTHER_GAIN <= k:
                level = k - OTHER_GAIN
                room[0, k, 1 + level, level] += part * rules.LEVELS[level][2] ** 2
    for k in range(NAMED):
        chance[k], P = room[1, k, 1, 0], drift.P[PLACES[k] :]
        for i in range(SIZES[k]):
            x[k, i] = room[0, k, 0, i]
            for j in range(i + 1):
                P[pack(i, j)] = room[0, k, 1 + i, j]


@inner
def _let_wander(drift: Drift, dt: float, nameless: float) -> None:
    """Something without a name begins, where all is still."""
    x, chance = drift.x, drift.chance
    still, wandering = drift.P[PLACES[STILL] :], drift.P[PLACES[WANDERING] :]
    stays = chance[WANDERING] * (1.0 - min(dt / rules.PERSISTENCE, 0.1))
    begins = (1.0 - chance[WANDERING]) * nameless
    chance[WANDERING] = stays + begins
    share = begins / max(stays + begins, 1e-300)
    for i in range(RATES):
        for j in range(i + 1):
            off = (x[STILL, i] - x[WANDERING, i]) * (x[STILL, j] - x[WANDERING, j])
            at = pack(i, j)
            wandering[at] += share * (still[at] - wandering[at])
            wandering[at] += share * (1.0 - share) * off
    for i in range(RATES):
        x[WANDERING, i] += share * (x[STILL, i] - x[WANDERING, i])


@inner
def _advance(drift: Drift, dt: float) -> None:
    """Prediction of the models that move."""
    wandering = drift.P[PLACES[WANDERING] :]
    lost = 1.0 - math.exp(-2.0 * dt / rules.WANDERS_WITHIN)
    for k in range(OF_VALVE):
        wandering[pack(k, k)] += lost * rules.LEVELS[k][3] ** 2
    for m in range(MOVING, SENSING + 1):
        _drift(drift.x[m], drift.P[PLACES[m] :], SIZES[m], dt)


@inner
def _drift(x: Floats, P: Floats, many: int, dt: float) -> None:
    """Prediction of levels that have rates."""
    keep = math.exp(-dt / rules.PERSISTENCE)
    for k in range(many - RATES):
        rate = RATES + k
        x[k] += dt * x[rate]
        P[pack(k, k)] += dt * (2.0 * P[pack(k, rate)] + dt * P[pack(rate, rate)])
        P[pack(k, k)] += dt * rules.LEVELS[k][1] ** 2 / 3600.0
        for j in range(many):
            if j != k:
                P[pack(k, j)] += dt * P[pack(rate, j)]
    for k in range(many - RATES):
        rate = RATES + k
        x[rate] *= keep
        for j in range(many):
            P[pack(rate, j)] *= keep
        P[pack(rate, rate)] *= keep
        P[pack(rate, rate)] += (1.0 - keep * keep) * (rules.LEVELS[k][0] / 3600.0) ** 2


@inner
def _combine(drift: Drift) -> None:
    """Mean and covariance over the named models.

    What has no name may be neither gain nor edge: while something wanders, they have a doubt as
    large as what it moves them by besides.
    """
    x, chance, now = drift.x, drift.chance, drift.now
    now[:] = 0.0
    for m in range(NAMED):
        for k in range(len(now[0])):
            now[0, k] += chance[m] * x[m, k]
    for m in range(NAMED):
        P = drift.P[PLACES[m] :]
        for k in range(len(now[0])):
            for j in range(k + 1):
                off = (x[m, k] - now[0, k]) * (x[m, j] - now[0, j])
                now[1 + k, j] += chance[m] * ((P[pack(k, j)] if k < SIZES[m] else 0.0) + off)
    for k in range(len(now[0])):
        for j in range(k):
            now[1 + j, k] = now[1 + k, j]
    for k in range(OF_VALVE):
        now[1 + k, k] += chance[WANDERING] * rules.LEVELS[k][3] ** 2
