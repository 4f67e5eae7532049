"""Parameters of `FlowMap` as published: flows, then the valve's physical quantities.

| name | meaning | unit |
|---|---|---|
| Q(U%,dpbar) | flow at a point of the map | l/min |
| gain | flow at full opening and 100 bar, per √Δp | l/min/√bar |
| dead_band | U at which 2 % of that flow passes at 100 bar | % |
| play | between U and the spool | % |
| temperature_coefficient | (dQ/dT) / Q at half opening and 100 bar, now | 1/K |
| gain_rate, edge_rate | drift | 1/h, %/h |

``opening`` is U > 0, ``closing`` U < 0, 0 ± 0 where the valve has no such side. A quantity that the
samples say nothing of is 0 with the standard deviation of what it may be; a flow is NaN then.
"""

from itertools import product
from typing import Final

import numpy as np

from valvemap.model import flow_map_looks
from valvemap.model.flow_arrays import Both, bare_memory, new_room
from valvemap.model.flow_map_state import FlowMapState
from valvemap.model.kernels import flow_drift, flow_fit, flow_look, flow_play
from valvemap.model.kernels import flow_rules as rules
from valvemap.model.samples import Floats

SECONDS_PER_HOUR: Final = 3600.0
SITES: Final = tuple(product(range(0, 101, 10), (5, 20, 50, 100, 150)))
SIDES: Final = "opening", "closing"
NAMES: Final = (
    *(f"Q({U}%,{dp}bar)" for U, dp in SITES),
    *(f"{name}_{side}" for name in ("gain", "dead_band") for side in SIDES),
    *("play", "temperature_coefficient"),
    *(f"{name}_{side}" for name in ("gain_rate", "edge_rate") for side in SIDES),
)
DP: Final = 100.0  # bar; at which gain and dead band are stated
OPENED: Final = 0.02  # of the flow at full opening; ends the dead band
STEPS: Final = 201  # points of U between which the end of the dead band is interpolated
MOST_OPENED: Final = 0.5  # of the flow at full opening; a valve that passes more when shut has none
SLIGHTLY: Final = 1.0  # K; step of the temperature coefficient


def parameters(state: FlowMapState, both: Both) -> tuple[Floats, Floats]:
    """Values and standard deviations, both (65,)."""
    U, dp = (np.array(x, np.float64) for x in zip(*SITES, strict=True))
    flows = flow_map_looks.predict(state, both, U, dp, np.full_like(U, np.nan))
    ends = both[0].breaks[-1], min(both[0].breaks[0], 0.0)
    edges = np.array([_edge(state, both, float(end)) for end in ends])  # side; of what; std
    moving = np.array(rates(state)).transpose(2, 1, 0)  # of what; side; std
    found = (
        *edges[:, 0],
        *edges[:, 1],
        _play(state),
        flow_look.warmth(
            *both, bare_memory(state), ends[0] / 2.0, DP, SLIGHTLY,
            new_room(),
        ),
        *moving.reshape(-1, 2),
    )  # fmt: skip
    values, stds = np.array(found).T
    return np.concatenate([flows[0], values]), np.concatenate([flows[1], stds])


def rates(state: FlowMapState) -> tuple[Floats, Floats]:
    """Rates of gain (1/h) and edge (%/h), and their standard deviations, (2, 2): by side."""
    places = slice(flow_drift.RATES, flow_drift.RATES + flow_drift.OF_VALVE)
    mean, covariance = state.now[:, 0, places], state.now[:, 1:][:, places, places]
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    return mean * SECONDS_PER_HOUR, np.sqrt(np.maximum(variance, 0.0)) * SECONDS_PER_HOUR


def _edge(state: FlowMapState, both: Both, end: float) -> Floats:
    """Gain and dead band on the side of ``end``, each with its standard deviation."""
    if end == 0.0:
        return np.zeros((2, 2))
    U = np.linspace(0.0, end, STEPS)
    Q, std = flow_map_looks.predict(
        state, both, U, np.full(STEPS, DP), np.full(STEPS, state.scalars[flow_fit.NOW_T])
    )
    full = abs(Q[-1])
    gain = np.array([full, std[-1]]) / np.sqrt(DP)
    shares = np.divide(np.abs(Q), full, out=np.zeros(STEPS), where=full > 0.0)  # 0: never opened
    opened = np.flatnonzero(shares > OPENED)
    if not np.isfinite(Q).all() or len(opened) == 0 or shares[0] > MOST_OPENED:
        none = np.array([0.0, abs(end)])
        return np.array([np.nan_to_num(gain), none])
    k = max(int(opened[0]), 1)
    slope = abs(Q[k] - Q[k - 1]) / (abs(end) / (STEPS - 1))
    low = abs(U[k - 1]) + (OPENED * full - abs(Q[k - 1])) / max(slope, 1e-9)
    band = max(low, 0.0) if opened[0] > 0 else 0.0
    return np.stack([gain, np.array([band, std[k] / max(slope, 1e-9)])])


def _play(state: FlowMapState) -> tuple[float, float]:
    half, known = float(state.play[flow_play.HALF]), float(state.play[flow_play.SLOPES])
    return 2.0 * half, float(2.0 / np.sqrt(known)) if known > 0.0 else rules.PLAY_STEP
