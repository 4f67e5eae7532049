"""The loop that compares estimators where a valve comes to a place after a while elsewhere."""

from typing import NamedTuple

import numpy as np

from valvemap.model.samples import Codes, Floats, Segments, Singles, Times
from valvemap.pipeline.kernels.compiled import inner, kernel
from valvemap.vocabulary.statuses import Quality, Status

AXES = 3  # U, sign(dp)·√|dp|, T
PLACES_U, PLACES_S, PLACES_T = 12, 8, 2  # most places along each axis
PLACES = PLACES_U * PLACES_S * PLACES_T

# Offsets in a valve's axes, in its sums, in its points, and in an estimator's places and sums.
LOW, HIGH, LOWER, HIGHER, WIDTH = range(5)
OF_AXIS = 5
COUNT, MEAN_Q, VARIANCE_Q, NOW, LEFT, KIND, TAKEN, DUE = range(8)
OF_VALVE = 8
AT_U, AT_DP, AT_T, AT_Q = range(4)
OF_POINT = 4
JUDGED, SQUARE, PAST, STD = range(4)
OF_PLACE = 4
ENTRIES, LOSS, LOSS_MEAN, SKILLED = range(4)
NEWEST, NOISE, NOISE_N, MULTIPLE, COVERED, COVERED_N = range(4, 10)
PAST_SQUARE, PAST_NOISE, EXCESS, TAIL, LOST, SCORE, FIT, CHOSEN = range(10, 18)
OF_LANE = 18

NARROWEST_U, NARROWEST_S, NARROWEST_T = 2.0**-8, 2.0**-8, 1.0  # %, √bar, °C; resolution of sensors
LARGEST = 1e9  # % and √bar; a larger value is no place
AWAY = 16  # samples; a place that was left for longer is visited again
VISIT = 32  # samples of a visit that are judged: estimators copy their map as often
MEMORY_Q = 65536.0  # samples; memory of the mean flow, once there are as many
RECENT = 3.0  # values; an average is over about the newest 1/(1 + RECENT) of them
MOST_JUDGED, MOST_ENTRIES = 4096.0, 2048.0  # samples at a place, and visits: longest memories
ENOUGH = 10.0  # visits before an estimator is compared with the mean flow
BETTER = 0.5  # share of the mean flow's squared error that a map may have at most
CERTAIN = 4.0  # standard errors by which the map must be better: it is judged at every visit
LOG_VARIANCE = 2.0 * (1.0 + RECENT) ** 2 / (1.0 + 2.0 * RECENT)  # of a mean square, times visits
FEW = 3.0  # samples; with more, an outlier of the flow is clipped
SPIKE_Q, SPIKE = 16.0, 25.0  # times the variance of Q, and the expected square; larger: clipped
GAUSSIAN = 1.959963984540054
WIDEST = 3.0  # times; most that an interval is widened because it held too seldom
TOLERATED = 1.3  # times; an interval is widened beyond this only: the multiple fluctuates
MISSES, PACE = 0.05, 0.05  # share outside the interval, and step of the multiple
COVERAGE_MEMORY = 100.0  # visits
HOLDS, TRIED = 0.8, 40.0  # least share inside, and visits before it is judged
NOISE_MEMORY = 1000.0  # samples

_BAD = int(Quality.BAD)
_OK, _WARMING_UP = int(Status.OK), int(Status.WARMING_UP)
_UNEXCITED, _FROZEN = int(Status.UNEXCITED), int(Status.FROZEN)
_UNRELIABLE = int(Status.UNRELIABLE)


class Record(NamedTuple):
    """Places of M valves, and the errors of E estimators there.

    axes : (M, 3, 5)
        Range of U, s and T: the second lowest and highest values, the lowest and highest, and the
        width of a place, a power of two.
    valves : (M, 8)
        Number of usable samples, mean and variance of Q; place of the last sample (-1: none), how
        many more samples of this visit are judged, and whether the place had been visited before;
        number of all samples, and that at which the maps are next evaluated at places left.
    seen : (M, places)
        Number of the newest sample at each place; 0: none.
    points : (M, places, 4)
        U, dp, T and Q of the first sample of each place's newest visit.
    places : (M, E, places, 4)
        Number of judged samples and their mean squared error; error of the newest map at the
        place's point, and the standard deviation published there.
    lanes : (M, E, 18)
        Number of visits, clipped mean square of map and mean flow, whether the map predicts better;
        residual of the last sample, noise variance from successive residuals and its number;
        multiple of the interval that holds 95 % of new visits, the share within it, and its number;
        mean squared error of the newest maps at all points, the noise in it, and the rest; 95 %
        quantile over the Gaussian one; whether the newest map is worse there than the mean flow;
        the error by which the estimators are ranked, l/min; what the errors say of the map, as an
        `Adaptation`; 0, or of the recommended estimator 1 and the probability that it is better.
    """

    axes: Floats
    valves: Floats
    seen: Times
    points: Singles
    places: Singles
    lanes: Floats


class Scratch(NamedTuple):
    """Room to merge places in: as `Record`'s arrays of one valve."""

    seen: Times
    points: Singles
    places: Singles


class Seen(NamedTuple):
    """N gated samples."""

    U: Floats
    dp: Floats
    T: Floats
    Q: Floats
    quality: Codes


@kernel
def learn(
    samples: Seen,
    residual: Floats,
    early: Floats,
    status: Codes,
    record: Record,
    scratch: Scratch,
    segments: Segments,
) -> None:
    """Add N samples and the residuals (E, N) of E estimators, in place.

    ``early`` (E, N) are the residuals of the maps as they were some samples before. ``status``
    (E, N) is written: OK becomes WARMING_UP until the map has predicted better than the mean flow,
    and UNRELIABLE where its interval does not hold.
    """
    members, starts, stops = segments
    E = len(residual)
    for k in range(len(members)):
        m = members[k]
        valve = record.valves[m]
        for i in range(starts[k], stops[k]):
            valve[TAKEN] += 1.0
            spread = valve[VARIANCE_Q]
            off, c, entered = 0.0, -1, False
            if samples.quality[i] != _BAD and abs(samples.Q[i]) < LARGEST:
                off = _note_flow(samples.Q[i], valve)
                c = _place(samples.U[i], samples.dp[i], samples.T[i], m, record, scratch)
            stays = c >= 0 and c == valve[NOW]
            if c >= 0:
                entered = _enter(c, i, samples, m, record)
            for e in range(E):
                lane, said = record.lanes[m, e], status[e, i]
                if c >= 0 and (said <= _UNEXCITED or said == _FROZEN):
                    place, error = record.places[m, e, c], residual[e, i]
                    if abs(error) < LARGEST:
                        if stays:
                            _note_noise(error - lane[NEWEST], lane)
                        lane[NEWEST] = error
                    if entered and abs(error) < LARGEST:
                        _compare(error * error, off * off, spread, lane)
                        if valve[KIND] > 0.0:
                            _cover(error * error, place, lane)
                    if valve[LEFT] > 0.0 and valve[KIND] > 0.0 and abs(early[e, i]) < LARGEST:
                        _judge(early[e, i] ** 2, place)
                if said == _OK:
                    status[e, i] = _of_map(lane)


@inner
def _note_flow(Q: float, valve: Floats) -> float:
    """Add a flow to its mean and variance; return its difference from the mean before."""
    off = Q - valve[MEAN_Q] if valve[COUNT] > 0.0 else 0.0
    valve[COUNT] += 1.0
    if valve[COUNT] <= 1.0:
        valve[MEAN_Q] = Q
        return 0.0
    share, step = _share(min(valve[COUNT], MEMORY_Q)), off
    if valve[COUNT] > FEW and valve[VARIANCE_Q] > 0.0:
        most = np.sqrt(SPIKE_Q * valve[VARIANCE_Q])
        step = min(max(off, -most), most)
    valve[MEAN_Q] += share * step
    valve[VARIANCE_Q] += share * ((1.0 - share) * step * step - valve[VARIANCE_Q])
    return float(off)


@inner
def _enter(c: int, i: int, samples: Seen, m: int, record: Record) -> bool:
    """Note a sample at a place; return whether it is the first of a visit."""
    valve, seen, point = record.valves[m], record.seen[m], record.points[m, c]
    again = seen[c] > 0
    entered = not again or valve[COUNT] - seen[c] > AWAY
    seen[c] = int(valve[COUNT])
    if entered:
        point[AT_U], point[AT_DP] = samples.U[i], samples.dp[i]
        point[AT_T], point[AT_Q] = samples.T[i], samples.Q[i]
        valve[LEFT], valve[KIND] = VISIT, 1.0 if again else 0.0
    elif c == valve[NOW]:
        valve[LEFT] = max(valve[LEFT] - 1.0, 0.0)
    else:
        valve[LEFT] = 0.0
    valve[NOW] = c
    return bool(entered)


@inner
def _of_map(lane: Floats) -> int:
    """Return the status of a map whose parameters are determined."""
    if lane[SKILLED] == 0.0:
        return _WARMING_UP
    missed = lane[COVERED_N] >= TRIED and lane[COVERED] < HOLDS
    return _UNRELIABLE if missed or lane[LOST] > 0.0 else _OK


@inner
def _note_noise(step: float, lane: Floats) -> None:
    """Estimate the noise from the difference of successive residuals at one place."""
    square = step * step / 2.0
    if lane[NOISE_N] > ENOUGH:
        square = min(square, SPIKE * lane[NOISE])
    lane[NOISE_N] = min(lane[NOISE_N] + 1.0, NOISE_MEMORY)
    lane[NOISE] += (square - lane[NOISE]) / lane[NOISE_N]


@inner
def _compare(square: float, off: float, spread: float, lane: Floats) -> None:
    """Compare the map with the mean flow; once better, it remains so."""
    most = SPIKE_Q * spread
    if not most > 0.0:
        return
    lane[ENTRIES] = min(lane[ENTRIES] + 1.0, MOST_ENTRIES)
    share = _share(lane[ENTRIES])
    lane[LOSS] += share * (min(square, most) - lane[LOSS])
    lane[LOSS_MEAN] += share * (min(off, most) - lane[LOSS_MEAN])
    if lane[ENTRIES] >= ENOUGH:
        error = CERTAIN * np.sqrt(2.0 * LOG_VARIANCE / lane[ENTRIES])  # of the ratio's logarithm
        if lane[LOSS] < min(BETTER, np.exp(-error)) * lane[LOSS_MEAN]:
            lane[SKILLED] = 1.0


@inner
def _cover(square: float, place: Singles, lane: Floats) -> None:
    """Note whether the first flow of a visit lies in the interval published for the place."""
    std = float(place[STD])
    noise = lane[NOISE] if lane[NOISE_N] > ENOUGH else lane[PAST_NOISE]
    expected = std * std + noise
    if not (expected > 0.0 and std > 0.0) or lane[SKILLED] == 0.0:
        return
    missed = 1.0 if square > (GAUSSIAN * lane[MULTIPLE]) ** 2 * expected else 0.0
    multiple = lane[MULTIPLE] * np.exp(PACE * (missed - MISSES))
    lane[MULTIPLE] = min(max(multiple, 1.0 / WIDEST), WIDEST)
    lane[COVERED_N] = min(lane[COVERED_N] + 1.0, COVERAGE_MEMORY)
    lane[COVERED] += (1.0 - missed - lane[COVERED]) / COVERAGE_MEMORY


@inner
def _judge(square: float, place: Singles) -> None:
    """Add an error at a place that is visited again."""
    if place[JUDGED] >= ENOUGH:
        square = min(square, SPIKE * float(place[SQUARE]))
    place[JUDGED] = min(place[JUDGED] + 1.0, MOST_JUDGED)
    place[SQUARE] += _share(float(place[JUDGED])) * (square - place[SQUARE])


@inner
def _share(n: float) -> float:
    """Weight of the n-th value in an average over about the newest quarter of all."""
    return float((1.0 + RECENT) / (n + RECENT))


@inner
def _place(U: float, dp: float, T: float, m: int, record: Record, scratch: Scratch) -> int:
    """Return the place of a sample, -1 if it lies beyond the ranges or is not finite.

    A range grows to the second most extreme value: one spike does not change it.
    """
    s = np.sign(dp) * np.sqrt(abs(dp))
    T = T if np.isfinite(T) else 0.0
    if not (abs(U) < LARGEST and abs(s) < LARGEST and abs(T) < LARGEST):
        return -1
    axes, inside = record.axes[m], True
    for a in range(AXES):
        x = U if a == 0 else s if a == 1 else T
        axis = axes[a]
        low = axis[LOW]
        if not axis[LOWER] <= axis[HIGHER]:
            axis[LOW], axis[HIGH], axis[LOWER], axis[HIGHER] = x, x, x, x
        elif x < axis[LOW]:
            inside &= x >= axis[LOWER]
            axis[LOW], axis[LOWER] = max(x, axis[LOWER]), min(x, axis[LOWER])
        elif x > axis[HIGH]:
            inside &= x <= axis[HIGHER]
            axis[HIGH], axis[HIGHER] = min(x, axis[HIGHER]), max(x, axis[HIGHER])
        most = _most(a)
        while np.floor(axis[HIGH] / axis[WIDTH]) - np.floor(axis[LOW] / axis[WIDTH]) >= most:
            _merge(a, low, m, record, scratch)
            axis[WIDTH] *= 2.0
    return _number(U, s, T, axes) if inside else -1


@inner
def _number(U: float, s: float, T: float, axes: Floats) -> int:
    u = int(np.floor(U / axes[0, WIDTH])) % PLACES_U
    v = int(np.floor(s / axes[1, WIDTH])) % PLACES_S
    w = int(np.floor(T / axes[2, WIDTH])) % PLACES_T
    return (u * PLACES_S + v) * PLACES_T + w


@inner
def _most(a: int) -> int:
    return PLACES_U if a == 0 else PLACES_S if a == 1 else PLACES_T


@inner
def _merge(a: int, low: float, m: int, record: Record, scratch: Scratch) -> None:
    """Merge each two neighbouring places along an axis; ``low``: the lowest place's value."""
    seen, points, places = record.seen[m], record.points[m], record.places[m]
    E, axis, most = len(places), record.axes[m, a], _most(a)
    step = PLACES_S * PLACES_T if a == 0 else PLACES_T if a == 1 else 1
    for c in range(PLACES):
        scratch.seen[c], seen[c] = seen[c], 0
        for j in range(OF_POINT):
            scratch.points[c, j], points[c, j] = points[c, j], 0.0
        for e in range(E):
            for j in range(OF_PLACE):
                scratch.places[e, c, j], places[e, c, j] = places[e, c, j], 0.0
    first = int(np.floor(low / axis[WIDTH])) if np.isfinite(low) else 0
    for k in range(first, first + most):
        old, new = k % most, (k >> 1) % most
        for other in range(PLACES // most):
            rest = other // step * step * most + other % step
            _add(rest + old * step, rest + new * step, seen, points, places, scratch, E)
    record.valves[m, NOW] = -1.0


@inner
def _add(
    old: int,
    new: int,
    seen: Times,
    points: Singles,
    places: Singles,
    scratch: Scratch,
    E: int,
) -> None:
    """Add a place of the scratch to another of the record."""
    if scratch.seen[old] > seen[new]:
        seen[new] = scratch.seen[old]
        for j in range(OF_POINT):
            points[new, j] = scratch.points[old, j]
    for e in range(E):
        place, more = places[e, new], scratch.places[e, old]
        n = place[JUDGED] + more[JUDGED]
        if n > 0.0:
            place[SQUARE] += (more[SQUARE] - place[SQUARE]) * more[JUDGED] / n
        place[JUDGED] = min(n, MOST_JUDGED)
        if scratch.seen[old] == seen[new]:
            place[PAST], place[STD] = more[PAST], more[STD]


@kernel
def places_of(
    U: Floats, dp: Floats, T: Floats, axes: Floats, seen: Times, out: Times, near: Floats
) -> None:
    """Write the nearest places of N points, -1 where nothing was measured, and their nearness.

    A point beyond the ranges has the place of the nearest point within. Errors of a map are alike
    over about one place: the nearness is 1 within the ranges, 1/e at one place beyond them.
    """
    for i in range(len(U)):
        s = np.sign(dp[i]) * np.sqrt(abs(dp[i]))
        t = T[i] if np.isfinite(T[i]) else axes[2, HIGH]
        u = min(max(U[i], axes[0, LOW]), axes[0, HIGH])
        v = min(max(s, axes[1, LOW]), axes[1, HIGH])
        w = min(max(t, axes[2, LOW]), axes[2, HIGH])
        c = _number(u, v, w, axes) if np.isfinite(u + v + w) else -1
        out[i] = c if c >= 0 and seen[c] > 0 else -1
        far = abs(U[i] - u) / axes[0, WIDTH] + abs(s - v) / axes[1, WIDTH]
        near[i] = np.exp(-far - abs(t - w) / axes[2, WIDTH])
