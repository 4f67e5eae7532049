"""The lags of one valve of `Auto`: when they are looked for, doubted, and what follows from it."""

import math
from dataclasses import fields
from typing import Final

import numpy as np

from service.identification import lag_search
from service.identification.auto_state import MAY_BE_UNKNOWN, AutoState, empty, last_rows
from service.identification.kernels import cells as memory
from service.identification.kernels import lag

SURE_AFTER: Final = 12_000  # samples: what changes before may still be the map itself
AFTER_CHANGE: Final = 300  # samples in which a map follows what is no lag
STAYS: Final = 0.5  # of the change's square: so large residuals are after one that is a lag
MOVED: Final = (  # rows kept; share, s: how far a lag may lie off the one that the map began with
    (4 * lag.ROWS, 0.02, 0.003),  # a new start costs little
    (8 * lag.ROWS, 0.06, 0.006),
    (math.inf, 0.15, 0.015),
)
OFTEN: Final = 32 * lag.ROWS  # rows for which a lag that is there is looked for every ROWS
FEWEST_STEPS: Final = 4  # rows from which the step from sample to sample is known

Given = tuple[float | None, float | None]  # lags of U and Q, s; None: looked for


def attend(state: AutoState, given: Given) -> None:
    """Do what is due of the lags of one valve; its state is written in place.

    ``given`` are the lags of U and Q that are not looked for, s.
    """
    kept = int(state.counters[memory.LAGGING + lag.KEPT_ROWS])
    if None in given:
        _doubt(state, kept)
    path = state.scalars[memory.LAGS :]
    if kept >= state.counters[memory.NEXT_LOOK]:
        _look(state, kept, given)
        since = kept - int(state.counters[memory.LAGGING + lag.LOOKED_FROM])
        often = max(path[lag.LAG_U], path[lag.LAG_Q]) > 0.0 and since < OFTEN
        state.counters[memory.NEXT_LOOK] = kept + (lag.ROWS if often else max(since, lag.ROWS))
    if path[lag.LAG_Q] > 0.0 and path[lag.SMOOTHING] == 0.0 and kept >= FEWEST_STEPS:
        _smooth(state)


def _doubt(state: AutoState, kept: int) -> None:
    """After a change that no map follows look for lags soon, and as often as at first."""
    counters = state.counters
    at = counters[memory.CHANGE_SAMPLE]
    is_new = AFTER_CHANGE <= counters[memory.USED] - at < lag.ROWS
    size, variance = state.scalars[[memory.CHANGE_SIZE, memory.VARIANCE]]
    stays = at > SURE_AFTER and variance > STAYS * size * size
    if (
        counters[memory.ALARMS]
        and is_new
        and stays
        and counters[memory.NEXT_LOOK] > kept + lag.ROWS
    ):
        counters[memory.NEXT_LOOK] = kept + lag.ROWS
        counters[memory.LAGGING + lag.LOOKED_FROM] = kept


def _look(state: AutoState, kept: int, given: Given) -> None:
    """Weigh what the last samples say of the lags; a map that began with others starts anew."""
    rows = last_rows(state)
    path = state.scalars[memory.LAGS :]
    before = float(path[lag.LAG_U]), float(path[lag.LAG_Q])
    since = int(state.counters[memory.LAGGING + lag.LOOKED_FROM])
    doubted = before if since > 0 and kept - since <= lag.ROWS else None
    found = lag_search.look(rows, path[lag.KNOWN_LAGS :], given, doubted)
    path[lag.LAG_U], path[lag.LAG_Q] = found
    began = float(path[lag.BEGAN_U]), float(path[lag.BEGAN_Q])
    share, least = next(how_far for until, *how_far in MOVED if kept - since <= until)
    if any(abs(b - a) > max(least, share * a) for a, b in zip(began, found, strict=True)):
        path[lag.BEGAN_U], path[lag.BEGAN_Q] = found
        _start_anew(state, given)
        _smooth(state)


def _start_anew(state: AutoState, given: Given) -> None:
    """Forget the map, and keep what is known of time, lags and changes."""
    fresh, path = empty(*given), state.scalars[memory.LAGS :].copy()
    path[MAY_BE_UNKNOWN] = math.nan
    kept = [
        *(memory.USED, memory.ALARMS, memory.NEXT_LOOK, memory.TOO_FAST),
        *(memory.CHANGE_SAMPLE, memory.CHANGE_TIME),
        *range(memory.LAGGING, memory.COUNTERS),
    ]
    counters, size = fresh.counters, state.scalars[memory.CHANGE_SIZE]
    counters[kept] = state.counters[kept]
    counters[[memory.OPENED, memory.BEGAN]] = counters[memory.USED]
    counters[memory.NEXT_FIT] += counters[memory.USED]
    for field in fields(state):
        if field.name != "recent":
            getattr(state, field.name)[...] = getattr(fresh, field.name)
    state.scalars[memory.LAGS :], state.scalars[memory.CHANGE_SIZE] = path, size


def _smooth(state: AutoState) -> None:
    """Choose the smoothing behind which the meter's lag is taken back; the signals begin anew."""
    path = state.scalars[memory.LAGS :]
    step = float(np.median(last_rows(state)[:, lag.STEP]))
    path[lag.SMOOTHING] = lag.smoothing(step, path[lag.LAG_Q])
    path[lag.U_EFFECT] = math.nan
