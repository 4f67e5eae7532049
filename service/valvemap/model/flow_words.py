"""A map of `FlowMap` in words: eq. (7) or smooth, then what else is in force.

>>> from valvemap.model.flow_map_state import axes, empty
>>> describe(empty(*axes((0.0, 100.0), (0.0, 200.0))))
'not fitted yet'
"""

from typing import Final

import numpy as np

from valvemap.model import drift_states
from valvemap.model.flow_map_state import FlowMapState
from valvemap.model.kernels import flow_drift as drifts
from valvemap.model.kernels import flow_fit as fits
from valvemap.model.kernels import flow_memory as memory
from valvemap.model.kernels import flow_path as paths
from valvemap.model.kernels import flow_play as plays
from valvemap.model.kernels import flow_rules as rules

OPERATORS: Final = {
    paths.DEAD_U: "U acts {:.2g} s late",
    paths.LAG_U: "lag of U {:.2g} s",
    paths.STICK: "friction {:.2g} %",
    paths.RELAYS: "hysteresis {:.2g} %",
    paths.CHOKE: "choked from {:.2g} p1 on",
    paths.KNEE: "compensated from {:.2g} bar on",
    paths.DEAD_Q: "Q is {:.2g} s late",
    paths.AVERAGE: "Q is a mean over {:.2g} s",
    paths.LAG_Q: "lag of Q {:.2g} s",
    paths.TOP: "meter ends at {:.3g} l/min",
    paths.LEAST: "meter dead below {:.2g} l/min",
    paths.NEWS: "U reacts to noise",
    paths.HELD_U: "U comes every {:.2g} s",
    paths.HELD_P: "pressures come every {:.2g} s",
    paths.HELD_Q: "Q comes every {:.2g} s",
    paths.NOISE_U: "U has noise of {:.2g} %",
}
LEVELS: Final = "gain", "edge", "zero of Q", "zero of Δp"


def is_plain(state: FlowMapState) -> bool:
    """Whether the map is likelier than not that of eq. (7)."""
    return bool(state.counters[memory.FITTED] and state.scalars[fits.PLAIN] > rules.WORTH_SAYING)


def describe(state: FlowMapState) -> str:
    """Return the effects in force, such as ``smooth; play 2.1 %; gain drifts``."""
    if not state.counters[memory.FITTED]:
        return "not fitted yet"
    parts = ["eq. (7)" if is_plain(state) else "smooth"]
    if state.play[plays.HALF] > 0.0:
        parts.append(f"play {2.0 * state.play[plays.HALF]:.2g} %")
    for k, words in OPERATORS.items():
        if state.path[k] > 0.0:
            parts.append(words.format(state.path[k]))
    if _by_temperature(state):
        parts.append("temperature")
    if (drift_states.drifting(state.chance) > rules.WORTH_SAYING).any():
        parts.append(f"{_moving(state)} drifts")
    return "; ".join(parts)


def _by_temperature(state: FlowMapState) -> bool:
    warm = np.arange(drifts.LEVELS, drifts.RATES)
    mean, variance = state.now[:, 0, warm], state.now[:, 1 + warm, warm]
    return bool((mean**2 > rules.SURE**2 * variance).any() and (variance > 0.0).any())


def _moving(state: FlowMapState) -> str:
    """Return what moves: the rate that is more standard deviations away from none."""
    drifting = state.chance[:, drifts.MOVING : drifts.SENSING + 1]
    side, m = divmod(int(np.argmax(drifting)), drifting.shape[1])
    m += drifts.MOVING
    places = np.arange(drifts.RATES, drifts.STATES)
    P = drift_states.covariance(state.P[side], m)[places, places]
    z = state.x[side, m, places] ** 2 / np.maximum(P, 1e-300)
    return LEVELS[int(np.argmax(z))]
