"""Which place a sample belongs to; places are merged in pairs as the ranges of signals grow."""

import numpy as np

from valvemap.model.samples import Floats, Singles, Times
from valvemap.pipeline.kernels.compiled import inner, kernel
from valvemap.pipeline.kernels.place_layout import (
    AXES,
    HIGH,
    HIGHER,
    JUDGED,
    LARGEST,
    LOW,
    LOWER,
    MOST_JUDGED,
    NOW,
    OF_PLACE,
    OF_POINT,
    PAST,
    PLACES,
    PLACES_S,
    PLACES_T,
    PLACES_U,
    SQUARE,
    STD,
    WIDTH,
    Record,
    Scratch,
)


@inner
def place_of(U: float, dp: float, T: float, m: int, record: Record, scratch: Scratch) -> int:
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
