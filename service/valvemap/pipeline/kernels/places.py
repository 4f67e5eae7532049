"""The loop that compares estimators where a valve comes to a place after a while elsewhere."""

from typing import NamedTuple

import numpy as np

from valvemap.model.samples import Codes, Floats, Segments, Singles
from valvemap.pipeline.kernels.compiled import inner, kernel
from valvemap.pipeline.kernels.place_layout import (
    AT_DP,
    AT_Q,
    AT_T,
    AT_U,
    COUNT,
    COVERED,
    COVERED_N,
    ENTRIES,
    JUDGED,
    KIND,
    LARGEST,
    LEFT,
    LOSS,
    LOSS_MEAN,
    LOST,
    MEAN_Q,
    MOST_JUDGED,
    MULTIPLE,
    NEWEST,
    NOISE,
    NOISE_N,
    NOW,
    PAST,
    PAST_NOISE,
    SKILLED,
    SQUARE,
    STD,
    TAKEN,
    VARIANCE_Q,
    WIDEST,
    Record,
    Scratch,
)
from valvemap.pipeline.kernels.place_numbers import place_of
from valvemap.vocabulary.statuses import Quality, Status

AWAY = 16  # samples; a place that was left for longer is visited again
VISIT = 32  # samples of a visit that are judged: estimators copy their map as often
MEMORY_Q = 65536.0  # samples; memory of the mean flow, once there are as many
RECENT = 3.0  # values; an average is over about the newest 1/(1 + RECENT) of them
MOST_ENTRIES = 2048.0  # visits; longest memory of an average over them
ENOUGH = 10.0  # visits before an estimator is compared with the mean flow
BETTER = 0.5  # share of the mean flow's squared error that a map may have at most
CERTAIN = 4.0  # standard errors by which the map must be better: it is judged at every visit
LOG_VARIANCE = 2.0 * (1.0 + RECENT) ** 2 / (1.0 + 2.0 * RECENT)  # of a mean square, times visits
FEW = 3.0  # samples; with more, an outlier of the flow is clipped
SPIKE_Q, SPIKE = 16.0, 25.0  # times the variance of Q, and the expected square; larger: clipped
GAUSSIAN = 1.959963984540054
TOLERATED = 1.3  # times; an interval is widened beyond this only: the multiple fluctuates
MISSES, PACE = 0.05, 0.05  # share outside the interval, and step of the multiple
COVERAGE_MEMORY = 100.0  # visits
HOLDS, TRIED = 0.8, 40.0  # least share inside, and visits before it is judged
NOISE_MEMORY = 1000.0  # samples

_BAD = int(Quality.BAD)
_OK, _WARMING_UP = int(Status.OK), int(Status.WARMING_UP)
_UNEXCITED, _FROZEN = int(Status.UNEXCITED), int(Status.FROZEN)
_UNRELIABLE = int(Status.UNRELIABLE)


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
                c = place_of(samples.U[i], samples.dp[i], samples.T[i], m, record, scratch)
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
                        place[PAST] = error
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
