"""The lags of one valve of `Auto`: when they are looked for, doubted, and what follows from it."""

import math
from typing import Final

from valvemap.model import lag_search
from valvemap.model.auto_anew import Rule, begin_anew, smooth
from valvemap.model.auto_state import AutoState, last_rows
from valvemap.model.kernels import cells as memory
from valvemap.model.kernels import lag

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


def attend(state: AutoState, rule: Rule, T: float) -> None:
    """Do what is due of the lags of one valve; its state is written in place.

    ``T`` is the oil's temperature now, °C.
    """
    kept = int(state.counters[memory.LAGGING + lag.KEPT_ROWS])
    if None in rule.given:
        _doubt(state, kept)
    path = state.scalars[memory.LAGS :]
    if kept >= state.counters[memory.NEXT_LOOK]:
        _look(state, kept, rule, T)
        since = kept - int(state.counters[memory.LAGGING + lag.LOOKED_FROM])
        often = max(path[lag.LAG_U], path[lag.LAG_Q]) > 0.0 and since < OFTEN
        state.counters[memory.NEXT_LOOK] = kept + (lag.ROWS if often else max(since, lag.ROWS))
    if path[lag.LAG_Q] > 0.0 and path[lag.SMOOTHING] == 0.0 and kept >= FEWEST_STEPS:
        smooth(state)


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


def _look(state: AutoState, kept: int, rule: Rule, T: float) -> None:
    """Weigh what the last samples say of the lags; a map that began with others starts anew."""
    rows = last_rows(state)
    path = state.scalars[memory.LAGS :]
    before = float(path[lag.LAG_U]), float(path[lag.LAG_Q])
    since = int(state.counters[memory.LAGGING + lag.LOOKED_FROM])
    doubted = since > 0 and kept - since <= lag.ROWS
    found = lag_search.look(rows, path[lag.KNOWN_LAGS :], rule.given, before, doubted=doubted)
    path[lag.LAG_U], path[lag.LAG_Q] = found
    began = float(path[lag.BEGAN_U]), float(path[lag.BEGAN_Q])
    share, least = next(how_far for until, *how_far in MOVED if kept - since <= until)
    if any(abs(b - a) > max(least, share * a) for a, b in zip(began, found, strict=True)):
        begin_anew(state, rule, began, T)
