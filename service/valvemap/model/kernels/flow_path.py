"""How the samples come from the map: a few operators between U and the spool, map and meter.

    U → dead time → lag → play | friction | relays → u      s → choking, compensator → s
    Q = meter(lag(mean(delay(g(u, s)))))

Each operator has one parameter, 0 where there is none. Which are there is decided by evidence, see
`flow_evidence`.

A signal may be published more rarely than others, and held between. U or Δp is then on its way from
one value to the next, along a straight line: a sample waits for the next value (`between`). Of Q a
new reading counts only. The measured U may have noise that the spool knows nothing of: a sample
waits for those behind it, which tell what U was (`calmed`).
"""

import math

import numpy as np

from valvemap.model.kernels import flow_rules as rules
from valvemap.model.kernels.compiled import inner, lean_kernel
from valvemap.model.samples import Floats, Singles

# Parameters, in the order of the operators.
DEAD_U, LAG_U = 0, 1  # s
PLAY, STICK, RELAYS = 2, 3, 4  # %; half the play; slip of friction; mean half play of relays
CHOKE, KNEE = 5, 6  # of p1 that Δp counts up to; bar that it counts up to
DEAD_Q, AVERAGE, LAG_Q = 7, 8, 9  # s
TOP, LEAST = 10, 11  # l/min
NEWS = 12  # 1 where Q goes with the news in U from sample to sample: U reacts to noise
PAST = 0.5  # of NEWS where the news is what the samples before did not tell, without those behind
OF_MAP = 13  # parameters up to here belong to a map; the others to the signals it is learnt from
HELD_U, HELD_P, HELD_Q = 13, 14, 15  # s; period of a signal that is published more rarely
NOISE_U = 16  # %; standard deviation of white noise of the measured U
PARAMETERS = 17

# Places in `path` behind the parameters.
GAINS = PARAMETERS  # log likelihood by which each is needed
LAGGED, STUCK, SEEN = 2 * PARAMETERS, 2 * PARAMETERS + 1, 2 * PARAMETERS + 2  # %, %; 1 once begun
LEAST_SEEN = 2 * PARAMETERS + 3  # l/min
HYSTERESIS = 2 * PARAMETERS + 4  # looks in which play left much, less the others
FLOOR = 2 * PARAMETERS + 5  # (l/min)²; least variance of the noise behind a meter's filter
MOST, MOST_GAIN = 2 * PARAMETERS + 6, 2 * PARAMETERS + 7  # l/min a pump delivers; evidence of it
PARTS = 2 * PARAMETERS + 8  # %; spools behind the relays, RELAY_COUNT places
RELAY_COUNT = 8
PHASE = PARTS + RELAY_COUNT  # slips from U to where friction holds the spool at the first row
PLACES = PHASE + 1

# Columns of the last samples.
STEP, LEFT_U, LEFT_DP, LEFT_P1, LEFT_Q = 0, 1, 2, 3, 4  # s since the row before, as measured
SPOOL = 5  # %; behind the operators
MEASURED_U = 5  # %; in the rows of `flow_evidence`, whose LEFT_U may be without noise
COLUMNS = 6


@inner
def waits(path: Floats) -> float:
    """How long a sample waits for the next values of signals that are held, s."""
    return float(rules.LATEST_VALUE * max(path[HELD_U], path[HELD_P]))


@inner
def looks_ahead(path: Floats) -> bool:
    """Whether later samples tell what the signals of one were."""
    return bool(waits(path) > 0.0 or path[NOISE_U] > 0.0)


@inner
def commanded(
    rows: Singles | Floats, row: int, known: int, ahead: int, path: Floats
) -> tuple[float, float]:
    """U at ``row`` as it was, and its standard deviation; see `between` and `calmed`."""
    if path[NOISE_U] > 0.0:
        return calmed(rows, row, known, ahead, LEFT_U, path[NOISE_U])
    return between(rows, row, known, ahead, LEFT_U, path[HELD_U])


@inner
def calmed(
    rows: Singles | Floats, row: int, known: int, ahead: int, column: int, noise: float
) -> tuple[float, float]:
    """A signal at ``row`` without its white noise, and its standard deviation.

    The mean of the rows beside it, of as many before as behind: on a straight line it is right. Of
    how many, the rows decide: means of more and more rows are taken as long as all their intervals
    have a value in common (Goldenshluger and Nemirovski 1997; Katkovnik 1999). ``known`` rows up
    to ``row`` and ``ahead`` behind it are known; ``rows`` is a ring.
    """
    mean, many, before, after = np.float64(rows[row, column]), 1.0, row, row
    low, high = mean - rules.APART_MEANS * noise, mean + rules.APART_MEANS * noise
    for _ in range(min(rules.BESIDE, known - 1, ahead)):
        is_after_gap = rows[before, STEP] >= rules.GAP
        before = before - 1 if before > 0 else len(rows) - 1
        after = after + 1 if after + 1 < len(rows) else 0
        if is_after_gap or rows[after, STEP] >= rules.GAP:
            break
        pair = 0.5 * (np.float64(rows[before, column]) + np.float64(rows[after, column]))
        wider = mean + 2.0 / (many + 2.0) * (pair - mean)
        width = rules.APART_MEANS * noise / math.sqrt(many + 2.0)
        low, high = max(low, wider - width), min(high, wider + width)
        if low > high:
            break
        mean, many = wider, many + 2.0
    return mean, noise / math.sqrt(many)


@inner
def between(
    rows: Singles | Floats, row: int, known: int, ahead: int, column: int, period: float
) -> tuple[float, float]:
    """A signal at ``row``, on its way between two values, and its standard deviation.

    The second comes a ``period`` after the first, or somewhat later; a signal that rests longer
    begins to move a period before. One that turns at a value may turn beside it as well.
    ``known`` rows up to ``row`` and ``ahead`` rows behind it are known; ``rows`` is a ring.
    """
    value = float(rows[row, column])
    if period <= 0.0:
        return value, 0.0
    longest, at, left = rules.LATEST_VALUE * period, row, 0.0
    after = value
    for _ in range(ahead):
        at = at + 1 if at + 1 < len(rows) else 0
        left += float(rows[at, STEP])
        if left > longest:
            break
        after = float(rows[at, column])
        if after != value:
            break
    if after == value:
        return value, 0.0
    at, age, before, span = row, 0.0, value, 0.0
    for _ in range(known - 1):
        step = float(rows[at, STEP])
        at = at - 1 if at > 0 else len(rows) - 1
        before = float(rows[at, column])
        if before != value or age + left > longest:
            span = age + left
            break
        age += step
    if not 0.0 < span <= longest:
        span, before = period, value
    share = max(1.0 - left / span, 0.0)
    off = 2.0 * share * (1.0 - share) * abs(after - 2.0 * value + before)
    return value + share * (after - value), off


@inner
def effective(dp: float, p1: float, path: Floats) -> float:
    """Root of the Δp that counts, √bar; ``p1`` is infinite where nothing is to choke."""
    size = abs(dp)
    if path[CHOKE] > 0.0:
        size = min(size, path[CHOKE] * max(p1, p1 - dp, 0.0))  # of the pressure upstream
    if path[KNEE] > 0.0:
        size = min(size, path[KNEE])
    return math.copysign(math.sqrt(size), dp)


@inner
def spool(U: float, step: float, fresh: bool, path: Floats) -> float:  # noqa: FBT001
    """Move the spool towards U, behind lag and hysteresis but for play; give where it is."""
    if fresh:
        path[LAGGED] = U
        path[STUCK], path[PHASE] = U + path[PHASE] * path[STICK], 0.0
        for k in range(RELAY_COUNT):
            path[PARTS + k] = U
    elif path[LAG_U] > 0.0:
        path[LAGGED] += (1.0 - math.exp(-step / path[LAG_U])) * (U - path[LAGGED])
    else:
        path[LAGGED] = U
    u = path[LAGGED]
    if path[STICK] > 0.0:
        if abs(u - path[STUCK]) > path[STICK]:
            path[STUCK] = u
        u = path[STUCK]
    elif path[RELAYS] > 0.0:
        mean = 0.0
        for k in range(RELAY_COUNT):
            half = 2.0 * path[RELAYS] * (k + 0.5) / RELAY_COUNT
            path[PARTS + k] = min(max(path[PARTS + k], u - half), u + half)
            mean += path[PARTS + k] / RELAY_COUNT
        u = mean
    return float(u)


@inner
def late(recent: Singles, newest: int, known: int, ahead: int, path: Floats) -> tuple[float, float]:
    """U as it was a dead time ago, and its standard deviation on the way between two rows.

    The oldest one where the rows do not reach so far.
    """
    back, _, share, _ = ago(recent, newest, known, path[DEAD_U])
    row = row_before(recent, newest, back)
    U, _ = commanded(recent, row, known - back, ahead + back, path)
    if share == 0.0:
        return U, 0.0
    older, back = row_before(recent, row, 1), back + 1
    U_older, _ = commanded(recent, older, known - back, ahead + back, path)
    before = row_before(recent, older, 1) if back + 1 < known else older
    at_older = abs(U - 2.0 * U_older + float(recent[before, LEFT_U]))
    at_newer = at_older
    if ahead + back > 1:
        after = row + 1 if row + 1 < len(recent) else 0
        at_newer = abs(float(recent[after, LEFT_U]) - 2.0 * U + U_older)
    off = min(share * (1.0 - share) * (at_newer + at_older), one_way(U_older, U, share))
    return U + share * (U_older - U), off


@inner
def one_way(older: float, newer: float, share: float) -> float:
    """Largest standard deviation, on the way between two rows, of a signal that goes one way there.

    It is at the one value or at the other, with the odds of the straight line. A signal that rests
    between two rows has none.
    """
    return math.sqrt(share * (1.0 - share)) * abs(newer - older)


@inner
def row_before(recent: Singles, row: int, back: int) -> int:
    """The row ``back`` rows before in the ring."""
    return row - back if row >= back else row - back + len(recent)


@inner
def ago(recent: Singles, newest: int, known: int, dead: float) -> tuple[int, float, float, bool]:
    """Where the time ``dead`` s ago lies: on the way between two rows.

    Rows and s back to the newer one; the share of the way to the older one; whether it is known.
    """
    age, row = 0.0, newest
    for back in range(known - 1):
        step = float(recent[row, STEP])
        if step >= rules.GAP:
            return back, age, 0.0, dead <= age
        if age + step > dead:
            return back, age, max(dead - age, 0.0) / step, True
        age += step
        row = row_before(recent, row, 1)
    return max(known - 1, 0), age, 0.0, dead <= age


@inner
def censored(Q: float, flow: float, path: Floats) -> bool:
    """Whether the meter shows a bound, beyond which the flow may well be."""
    end = rules.NEAR_TOP * path[TOP]
    if path[TOP] > 0.0 and (end < Q or (end < flow and rules.WELL_BELOW_TOP * path[TOP] < Q)):
        return True
    return bool(path[LEAST] > 0.0 and abs(Q) < rules.NEAR_LEAST * path[LEAST])


@inner
def shown(flow: float, path: Floats) -> float:
    """Flow as the meter shows it within its range."""
    if path[TOP] > 0.0 and flow > path[TOP]:
        return float(path[TOP])
    if path[LEAST] > 0.0 and abs(flow) < path[LEAST]:
        return 0.0
    return flow


@lean_kernel
def has_past(path: Floats) -> bool:
    """`shows_past`, called from Python."""
    return shows_past(path)


@inner
def filters(path: Floats) -> bool:
    """Whether the meter shows flow of several moments."""
    return bool(path[AVERAGE] > 0.0 or path[LAG_Q] > 0.0)


@inner
def shows_past(path: Floats) -> bool:
    """Whether the meter shows other flow than that of the moment."""
    return bool(path[DEAD_Q] > 0.0 or filters(path))


@inner
def forward(flow: float, side: int, s: float, least: float) -> float:
    """The map's flow, which runs against Δp by an offset of the meter, ``least`` < 0, at most."""
    along = math.copysign(1.0, s) * (1.0 if side == 0 else -1.0)
    return along * max(flow * along, least)


@inner
def root_between(newer: float, older: float, share: float) -> float:
    """Root of the Δp on the way between two of given roots."""
    dp = newer * abs(newer)
    dp += share * (older * abs(older) - dp)
    return math.copysign(math.sqrt(abs(dp)), dp)
